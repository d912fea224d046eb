"""The lock-step scheduler: no vehicle passes a meeting early or runs ahead, and none waits for ever."""

from hypothesis import given
from hypothesis import strategies as st

from ptnsbc_nodes.comm.graph import LEAD_TICKS
from ptnsbc_nodes.sim.lockstep import LockstepScheduler

IDS = (1, 2, 3)


def publish_all(scheduler: LockstepScheduler) -> list[int]:
    due = scheduler.due()
    for i in due:
        scheduler.mark_published(i)
    return due


def test_one_vehicle_need_not_wait_for_another():
    scheduler = LockstepScheduler(IDS, 9, (5,))
    assert publish_all(scheduler) == [1, 2, 3]
    assert scheduler.due() == []
    scheduler.step(2)
    assert publish_all(scheduler) == [2]
    assert (scheduler.at(2), scheduler.slowest) == (1, 0)
    assert scheduler.awaited(2)


def test_all_wait_at_a_meeting():
    scheduler = LockstepScheduler(IDS, 9, (2, 3))
    for _ in range(2):
        publish_all(scheduler)
        scheduler.step(1)
    assert (scheduler.at(1), publish_all(scheduler)) == (2, [])
    for i in (2, 3):
        scheduler.step(i)
        publish_all(scheduler)
        scheduler.step(i)
    assert sorted(publish_all(scheduler)) == [1, 2, 3]


@given(
    st.lists(st.sampled_from(IDS), min_size=30, max_size=200),
    st.lists(st.integers(1, 9), min_size=0, max_size=2),
)
def test_any_order_of_answers(answers: list[int], meetings: list[int]):
    scheduler = LockstepScheduler(IDS, 1000, meetings)
    for uav in answers:
        for i in publish_all(scheduler):
            assert scheduler.at(i) - scheduler.slowest <= LEAD_TICKS
            if any(scheduler.at(i) % period == 0 for period in meetings):
                assert {scheduler.at(j) for j in IDS} == {scheduler.at(i)}
        assert any(scheduler.awaited(i) for i in IDS)  # some UAV can always answer
        if scheduler.awaited(uav):
            scheduler.step(uav)
    publish_all(scheduler)
    assert scheduler.awaited(min(IDS, key=scheduler.at))  # and the slowest is never kept waiting


def test_the_state_at_the_end_is_not_published():
    scheduler = LockstepScheduler(IDS, 2, ())
    for _ in range(2):
        for i in publish_all(scheduler):
            scheduler.step(i)
    assert scheduler.slowest == 2
    assert scheduler.due() == []
