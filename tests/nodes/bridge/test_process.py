"""The process of a bridge: which signals land its vehicle, and which one ends it."""

from __future__ import annotations

import os
import signal
import sys
from subprocess import PIPE, Popen

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
