"""One UAV process and its bridge on a quarter of a core, as on a small computer, in a fleet of four on stand-ins.

A control group (version 1, by root) gives the two of every 100 ms 25 ms with real-time scheduling, and 25 ms without
it. The other processes of the fleet have whole cores.
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from bench.processes import BenchError, Observer, Sample, children, look, missed_percent
from bench.session import Plan, own_domain, print_progress
from bench.stand_ins import program, stand_ins, write_scenario
from bench.table import Row, Target
from ptnsbc_nodes.fleet.child_process import BRIDGE, UAV

_GROUP = Path("/sys/fs/cgroup/cpu/ptnsbc-bench")
_GIVEN = {"rt_period_us": 4, "rt_runtime_us": 1, "cfs_period_us": 4, "cfs_quota_us": 1}  # in 25 ms
_SMALL, _WHOLE = "3", ("1", "2", "4")
_ROLES = {UAV: "UAV", BRIDGE: "bridge"}
_LOOK_S = 0.05


@contextmanager
def _quarter() -> Iterator[Path]:
    """The file that takes the processes of the group."""
    try:
        _GROUP.mkdir()
        for name, quarters in _GIVEN.items():
            (_GROUP / f"cpu.{name}").write_text(str(25_000 * quarters))
    except OSError as error:
        raise BenchError(f"no control group for a quarter of a core: {error}") from None
    try:
        yield _GROUP / "cgroup.procs"
    finally:
        _GROUP.rmdir()


def measure(plan: Plan) -> Iterator[Row]:
    """Rows of this section."""
    seen: dict[str, Sample] = {}  # the last of each process of the group
    print_progress("a fleet on four stand-ins, one UAV on a quarter of a core")
    with tempfile.TemporaryDirectory(prefix="bench-") as name, own_domain() as domain:
        scenario, control = write_scenario(Path(name), plan.of(60.0, 20.0))
        words = ("fleet", scenario, "--backend", "mavlink", "--allow-arming")
        with (
            _quarter() as group,
            stand_ins(Path(name), domain, scenario, control),
            Observer(domain) as observer,
            program(Path(name), "fleet", domain, "ptnsbc_tools.cli", *words) as fleet,
        ):
            while fleet.process.poll() is None:
                for pid in children(fleet.process.pid):
                    with suppress(OSError):  # it has just ended
                        called = Path(f"/proc/{pid}/cmdline").read_text().split("\0")
                        for module in _ROLES.keys() & called if _SMALL in called else ():
                            group.write_text(str(pid))
                            seen[_ROLES[module]] = look(pid)
                time.sleep(_LOOK_S)  # nothing tells when a launcher starts a process
        values = observer.newest()
    if fleet.process.returncode or len(seen) < len(_ROLES):
        raise BenchError(f"not flown: {fleet.log.read_text()[-2000:]}")
    missed = [missed_percent([values[f"uav{uav}"]]) for uav in (_SMALL, *_WHOLE)]
    name = "UAV and bridge on 25 % of a core, 100 Hz: "
    yield Row(
        f"{name}missed ticks", missed[:1], "%", "on whole cores", missed[1:], target=Target(1.0)
    )
    for role, sample in seen.items():
        yield Row(f"{name}memory of the {role}", [sample.rss_mb], "MB", target=Target(110.0))
