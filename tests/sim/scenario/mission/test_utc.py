"""Times in UTC: instants, and times that recur."""

import pytest

from ptnsbc_sim.scenario.mission.utc import utc_time

NOON_NS = 1_795_348_800_000_000_000  # 2026-11-22T12:00:00Z
SECOND_NS = 1_000_000_000


def test_an_instant_is_the_same_whenever_it_is_asked_for() -> None:
    found = utc_time("2026-11-22T12:00:00.5Z")
    assert found == (NOON_NS + SECOND_NS // 2, 0)
    assert found.next_ns(0) == found.next_ns(2 * NOON_NS) == found.first_ns


@pytest.mark.parametrize(
    ("text", "late_s"), [("12:00:07.25Z", 86_400), ("*:00:07.25Z", 3600), ("*:*:07.25Z", 60)]
)
def test_a_time_that_recurs_is_the_first_one_from_now_on(text: str, late_s: int) -> None:
    at_ns = NOON_NS + 7 * SECOND_NS + SECOND_NS // 4
    found = utc_time(text)
    assert found.next_ns(NOON_NS) == found.next_ns(at_ns) == at_ns
    assert found.next_ns(at_ns + 1) == at_ns + late_s * SECOND_NS


@pytest.mark.parametrize(
    ("start", "at", "after_s"),
    [
        ("2026-11-22T12:00:00Z", "2026-11-22T12:00:09.5Z", 9.5),
        ("2026-11-22T12:00:00Z", "*:*:09Z", 9),
        ("23:59:50Z", "00:00:05Z", 15),
        ("*:59:50Z", "*:00:05Z", 15),
        ("12:00:50Z", "*:*:05Z", 15),
    ],
)
def test_the_time_from_one_to_the_first_of_another(start: str, at: str, after_s: float) -> None:
    first, then = utc_time(start), utc_time(at)
    assert then.follows(first)
    assert then.after(first) == round(after_s * SECOND_NS)


@pytest.mark.parametrize(
    ("start", "at"),
    [("12:00:00Z", "2026-11-22T12:00:09Z"), ("*:*:00Z", "*:00:09Z"), ("*:00:00Z", "12:00:09Z")],
)
def test_a_rarer_time_has_no_one_distance_from_one_that_recurs(start: str, at: str) -> None:
    assert not utc_time(at).follows(utc_time(start))


@pytest.mark.parametrize(
    "text",
    ["soon", "12:00:05", "24:00:00Z", "12:*:05Z", "*:*:*Z", "*:*:60Z", "1700000000", "Z", "*:*:5Z"],
)
def test_other_texts_are_refused(text: str) -> None:
    with pytest.raises(ValueError, match=r".*"):
        utc_time(text)
