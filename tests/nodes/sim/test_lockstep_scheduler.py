"""Whose turn it is: nobody passes a meeting early, nobody runs away, nobody waits for ever."""

from hypothesis import given
from hypothesis import strategies as st

from ptnsbc_nodes.comm.graph import LEAD_TICKS
from ptnsbc_nodes.sim.lockstep_scheduler import LockstepScheduler

IDS = (1, 2, 3)


def tell_all(turns: LockstepScheduler) -> list[int]:
    due = turns.due()
    for i in due:
        turns.tell(i)
    return due


def test_one_vehicle_need_not_wait_for_another():
    turns = LockstepScheduler(IDS, 9, (5,))
    assert tell_all(turns) == [1, 2, 3]
    assert turns.due() == []
    turns.step(2)
    assert tell_all(turns) == [2]
    assert (turns.at(2), turns.slowest) == (1, 0)
    assert turns.awaited(2)


def test_all_wait_at_a_meeting():
    turns = LockstepScheduler(IDS, 9, (2, 3))
    for _ in range(2):
        tell_all(turns)
        turns.step(1)
    assert (turns.at(1), tell_all(turns)) == (2, [])
    for i in (2, 3):
        turns.step(i)
        tell_all(turns)
        turns.step(i)
    assert sorted(tell_all(turns)) == [1, 2, 3]


@given(
    st.lists(st.sampled_from(IDS), min_size=30, max_size=200),
    st.lists(st.integers(1, 9), min_size=0, max_size=2),
)
def test_any_order_of_answers(answers: list[int], meetings: list[int]):
    turns = LockstepScheduler(IDS, 1000, meetings)
    for who in answers:
        for i in tell_all(turns):
            assert turns.at(i) - turns.slowest <= LEAD_TICKS
            if any(turns.at(i) % period == 0 for period in meetings):
                assert {turns.at(j) for j in IDS} == {turns.at(i)}
        assert any(turns.awaited(i) for i in IDS)  # somebody can always answer
        if turns.awaited(who):
            turns.step(who)
    tell_all(turns)
    assert turns.awaited(min(IDS, key=turns.at))  # and the slowest is never kept waiting


def test_nobody_is_told_the_end():
    turns = LockstepScheduler(IDS, 2, ())
    for _ in range(2):
        for i in tell_all(turns):
            turns.step(i)
    assert turns.slowest == 2
    assert turns.due() == []
