"""Finding the nominal deadline of a law that settles early."""

import pytest

from ptnsbc_tools.reproduce.matching import deadline_for
from ptnsbc_tools.reproduce.part import ReproduceError


@pytest.mark.parametrize("share", [0.1, 0.4, 1.0])
def test_a_law_that_settles_at_a_share_of_its_promise(share: float) -> None:
    found = deadline_for(lambda deadline: share * deadline, 4.0)
    assert share * found == pytest.approx(4.0, rel=0.011)


def test_a_law_that_is_always_early_cannot_be_matched() -> None:
    with pytest.raises(ReproduceError, match="expected a slower law"):
        deadline_for(lambda deadline: 0.01 * deadline, 4.0)


def test_a_law_that_never_settles_is_late() -> None:
    found = deadline_for(lambda deadline: None if deadline > 9.0 else 0.5 * deadline, 4.4)
    assert 0.5 * found == pytest.approx(4.4, rel=0.011)


def test_a_jump_is_approached_from_below() -> None:
    found = deadline_for(lambda deadline: 1.0 if deadline < 7.0 else 9.0, 4.0)
    assert found == pytest.approx(7.0, abs=0.01)
    assert found < 7.0
