"""Computers that are none: network namespaces of the kernel, joined by a virtual cable.

Needs root, iproute2 and nftables. The delay of a real network is missing: only loss is made here.
"""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
CABLE = "cable"
PATIENCE_S = 240  # a first flight compiles the laws

_RULES = """
table inet cable {{
  counter sent {{ }}
  chain outgoing {{
    type filter hook output priority 0;
    oifname "{cable}" counter name sent
  }}
  chain incoming {{
    type filter hook input priority 0;
    iifname "{cable}" ip protocol udp numgen random mod 100 < {percent} drop
  }}
}}
"""


def _run(*words: str, text: str | None = None) -> str:
    done = subprocess.run(words, input=text, capture_output=True, text=True, check=False)
    if done.returncode:
        raise OSError(f"{' '.join(words)}: {done.stderr.strip() or done.returncode}")
    return done.stdout


def _inside(namespace: str, *words: str) -> tuple[str, ...]:
    return ("ip", "netns", "exec", namespace, *words)


class Computer:
    """One network namespace, with one address on the cable."""

    def __init__(self, name: str, address: str) -> None:
        self.name = name
        self.address = address

    def prepare(self, loss_percent: int) -> None:
        """Loopback, the cable as the way to everywhere, and the loss of packets that come in."""
        ip = ("ip", "-n", self.name)
        _run(*ip, "address", "add", f"{self.address}/24", "dev", CABLE)
        for device in ("lo", CABLE):
            _run(*ip, "link", "set", device, "up")
        _run(*ip, "route", "add", "default", "dev", CABLE)
        rules = _RULES.format(cable=CABLE, percent=loss_percent)
        _run(*self.inside("nft", "-f", "-"), text=rules)

    def inside(self, *words: str) -> tuple[str, ...]:
        """The command line that runs `words` on this computer."""
        return _inside(self.name, *words)

    def start(self, *words: str, **environment: str) -> subprocess.Popen[str]:
        """Start `python ...` there."""
        inherited = {
            key: value
            for key, value in os.environ.items()
            if not key.startswith(("ROS_DOMAIN", "ROS_AUTOMATIC", "FASTRTPS_", "FASTDDS_"))
        }
        return subprocess.Popen(
            self.inside(sys.executable, *words),
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            cwd=ROOT,
            env={**inherited, "PYTHONFAULTHANDLER": "1", **environment},
        )

    def ptnsbc(self, *words: object, **environment: str) -> subprocess.Popen[str]:
        """Start `ptnsbc ...` there."""
        return self.start("-m", "ptnsbc_tools.cli", *map(str, words), **environment)

    def packets_sent(self) -> int:
        """Packets that have left this computer over the cable."""
        rules = json.loads(_run(*self.inside("nft", "-j", "list", "counters")))
        (counter,) = [entry["counter"] for entry in rules["nftables"] if "counter" in entry]
        return int(counter["packets"])


def missing() -> str | None:
    """The reason why there can be no namespaces here; None when there can."""
    if os.geteuid() != 0:
        return "network namespaces need root"
    for program, package in {"ip": "iproute2", "nft": "nftables"}.items():
        if shutil.which(program) is None:
            return f"{program} is not installed (package {package})"
    try:
        with computers():
            return None
    except OSError as error:
        return f"no network namespaces here: {error}"


@contextmanager
def computers(count: int = 2, loss_percent: int = 0) -> Iterator[tuple[Computer, ...]]:
    """Computers on one switch; each loses so many of the packets it gets."""
    made = tuple(Computer(f"ptnsbc{os.getpid()}-{i}", f"10.77.0.{i}") for i in range(1, count + 1))
    switch = f"ptnsbc{os.getpid()}-switch"
    with ExitStack() as stack:
        for name in (switch, *(computer.name for computer in made)):
            _run("ip", "netns", "add", name)
            stack.callback(_run, "ip", "netns", "delete", name)
            _run(*_inside(name, "sysctl", "-qw", "net.ipv6.conf.all.disable_ipv6=1"))
        _run("ip", "-n", switch, "link", "add", "switch", "type", "bridge")
        _run("ip", "-n", switch, "link", "set", "switch", "up")
        for number, computer in enumerate(made):
            port = f"port{number}"
            cable = ("ip", "link", "add", CABLE, "netns", computer.name, "type", "veth")
            _run(*cable, "peer", "name", port, "netns", switch)
            _run("ip", "-n", switch, "link", "set", port, "master", "switch", "up")
            computer.prepare(loss_percent)
        yield made


def finished(
    process: subprocess.Popen[str], patience_s: float = PATIENCE_S
) -> tuple[int, str, str]:
    """Exit code and what was said; a process that hangs is ended, and says where it was."""
    try:
        out, err = process.communicate(timeout=patience_s)
    except subprocess.TimeoutExpired:
        process.send_signal(signal.SIGABRT)
        out, err = process.communicate()
        raise AssertionError(f"still running after {patience_s} s:\n{out}\n{err}") from None
    return process.returncode, out, err
