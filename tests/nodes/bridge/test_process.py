"""The process of a bridge: which signals land its vehicle, which one ends it, and a port that is not free yet."""

from __future__ import annotations

import os
import signal
import socket
import sys
from subprocess import PIPE, Popen
from types import SimpleNamespace

import pytest

pytest.importorskip("pymavlink")

from ptnsbc_io.mavlink.transport import PortTakenError
from ptnsbc_nodes.bridge.bridge import open_link

_BRIDGE = """
from ptnsbc_nodes.bridge.process import _LandingLifetime
from ptnsbc_nodes.runtime.launcher import stay_with_launcher
import signal, types
stay_with_launcher()
lifetime = _LandingLifetime()
lifetime.bridge = types.SimpleNamespace(land=lambda: print("lands", flush=True) or True)
print("flies", flush=True)
while not lifetime.over:
    signal.pause()
print("ends", flush=True)
"""
_LAUNCHER = """
import os, subprocess, sys
environment = os.environ | {"PTNSBC_PARENT": str(os.getpid())}
bridge = subprocess.Popen([sys.executable, "-c", sys.argv[1]], env=environment)
print(bridge.pid, flush=True)
bridge.wait()
"""


def test_a_launcher_that_is_killed_ends_no_bridge_whose_vehicle_lands() -> None:
    """The kernel tells a bridge of it by the signal that an operator's second request is as well."""
    launcher = Popen([sys.executable, "-c", _LAUNCHER, _BRIDGE], stdout=PIPE, text=True)
    lines = iter(launcher.stdout.readline, "")
    words = {next(lines).strip(), next(lines).strip()}
    assert "flies" in words
    (pid,) = (int(word) for word in words if word.isdecimal())
    os.kill(pid, signal.SIGTERM)  # the launcher's order to land
    assert next(lines) == "lands\n"
    launcher.kill()
    assert next(lines) == "lands\n"
    os.kill(pid, signal.SIGTERM)  # of a person who wants no more
    assert next(lines) == "ends\n"
    launcher.wait()


class _Holder:
    """`ptnsbc stop` at the port of a vehicle; it leaves when the bridge has found the port taken twice."""

    def __init__(self) -> None:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.bind(("127.0.0.1", 0))
        connect = f"udpin:127.0.0.1:{self._socket.getsockname()[1]}"
        self.settings = SimpleNamespace(connect=connect, sysid=1)
        self._found = 0

    def found(self) -> bool:
        """The bridge has found the port taken; nobody has told it to end."""
        self._found += 1
        if self._found == 2:
            self.close()
        return False

    def close(self) -> None:
        self._socket.close()


def test_a_bridge_waits_for_a_port_that_an_order_past_a_dead_one_holds() -> None:
    holder = _Holder()
    open_link(holder.settings, "", holder.found).close()


def test_a_port_that_stays_taken_or_a_signal_ends_the_wait() -> None:
    holder = _Holder()
    with pytest.raises(PortTakenError, match="expected a free port"):
        open_link(holder.settings, "", holder.found, taken_s=0.0)
    with pytest.raises(PortTakenError, match="does another bridge"):
        open_link(holder.settings, "", lambda: True)
    holder.close()
