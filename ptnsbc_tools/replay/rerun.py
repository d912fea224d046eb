"""A bag through the controllers again: every step from its recorded inputs, every output beside the recorded.

The bag streams by; memory does not grow with it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, nullcontext
from functools import partial
from typing import NamedTuple

from ptnsbc_io.bag import Bag, BagError, BagMessage
from ptnsbc_io.wire import WireError
from ptnsbc_nodes.comm import topics
from ptnsbc_sim.scenario import Scenario
from ptnsbc_tools.replay.difference import Difference
from ptnsbc_tools.replay.lockstep import Lockstep
from ptnsbc_tools.replay.parallel import side_by_side
from ptnsbc_tools.replay.realtime import Realtime
from ptnsbc_tools.replay.replay_state import ReplayState
from ptnsbc_tools.replay.uav_replay import Account

Advance = Callable[[int, int], None]
Progress = Callable[[], AbstractContextManager[Advance]]

EQUAL, DIFFERENT, VOID = "equal", "different", "void"

_EVERY = 5000  # messages between two reports of progress


def _unseen() -> AbstractContextManager[Advance]:
    return nullcontext(lambda done, total: None)


class Rerun(NamedTuple):
    """What came of it."""

    realtime: bool
    flown_s: float  # length of the bag
    accounts: dict[int, Account]  # by UAV

    @property
    def first(self) -> Difference | None:
        """The first difference in the flight."""
        found = [one.difference for one in self.accounts.values() if one.difference is not None]
        return min(found, key=lambda one: one.stamp_ns, default=None)

    @property
    def verdict(self) -> str:
        """Worst of all UAVs: `different`, `void` when something could not be compared, or `equal`."""
        if self.first is not None:
            return DIFFERENT
        accounts = self.accounts.values()
        holes = any(one.gaps or one.unrecorded or not one.compared for one in accounts)
        return VOID if holes else EQUAL


def rerun(bag: Bag, scenario: Scenario, progress: Progress = _unseen, jobs: int = 1) -> Rerun:
    """Re-run every step of every UAV.

    Args:
        bag: a flight of ours, from `read_bag`.
        scenario: what was flown.
        progress: entered for what is called now and then with messages done and in all.
        jobs: processes among which the UAVs are shared out.

    Raises:
        BagError: nothing to re-run, or a message that is none.
    """
    noted = any(_messages(bag, topics.tick(uav).name) for uav in scenario.uav_ids)
    ids = scenario.uav_ids
    groups = [ids[k::jobs] for k in range(min(jobs, len(ids)))]
    work = [partial(_of, bag, scenario, group, noted) for group in groups]
    found: dict[int, Account] = {}
    for part in side_by_side([partial(work[0], progress), *work[1:]]):
        found |= part
    accounts = {uav: found[uav] for uav in ids}
    if not any(one.steps or one.gaps for one in accounts.values()):
        raise BagError(f"{bag.path}: no step to re-run: expected odometry and an epoch")
    return Rerun(noted, (bag.end_ns - bag.start_ns) * 1e-9, accounts)


def _of(
    bag: Bag, scenario: Scenario, uavs: Sequence[int], noted: bool, progress: Progress = _unseen
) -> dict[int, Account]:
    """Accounts of some UAVs."""
    desk = ReplayState(scenario, uavs)
    driver: Realtime | Lockstep = Realtime(desk) if noted else Lockstep(desk)
    with progress() as advance:  # here: a bar has a thread, and threads do not survive a fork
        for message in _shown(bag, desk.wanted(bag), advance):
            try:
                desk.put(message)
                if message.topic in driver.triggers:
                    driver.take(message.topic, message.stamp_ns, message.data)
                    driver.make_due(message.stamp_ns)
            except WireError as error:
                raise BagError(f"{bag.path}: a message on {message.topic}: {error}") from None
        driver.make_all()
    return {uav: seat.account for uav, seat in desk.seats.items()}


def _messages(bag: Bag, name: str) -> int:
    return bag.topics[name].messages if name in bag.topics else 0


def _shown(bag: Bag, wanted: list[str], advance: Advance) -> Iterator[BagMessage]:
    total = sum(_messages(bag, name) for name in wanted)
    for done, message in enumerate(bag.messages(wanted), start=1):
        yield message
        if done % _EVERY == 0 or done == total:
            advance(done, total)
