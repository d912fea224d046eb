"""The transcript of a law outside the repository says what its commands print now."""

from __future__ import annotations

import pytest

from docs.make.transcript import PAGE, lasting, made
from ptnsbc_nodes.runtime.environment import free_domain


def test_times_and_digits_of_lengths_do_not_count_verdicts_and_counts_do() -> None:
    said = "equal: 4000 steps; 8.0 s of flight in 1.9 s\n━━━━┳━━\n│ error │ 0.02252 │ -10.0 % │"
    slower = (
        "equal: 4000 steps; 8.0 s of flight in 13.7 s\n━━━━━┳━━\n│ error │ +0.022519 │ -10.0 % │"
    )
    assert lasting(said) == lasting(slower)
    for now, later in (("4000", "3999"), ("equal", "differs"), ("-10.0 %", "-15.0 %")):
        assert lasting(said) != lasting(said.replace(now, later))


@pytest.mark.slow
@pytest.mark.ros
def test_the_page_is_what_the_commands_print(monkeypatch: pytest.MonkeyPatch) -> None:
    """If it fails although all is well: `python -m docs.make.transcript` writes the page anew."""
    with free_domain() as domain:
        monkeypatch.setenv("ROS_DOMAIN_ID", str(domain))
        now = made()
    assert lasting(now) == lasting(PAGE.read_text("utf-8"))
