"""Findings about the parameters of an autopilot: advice and refusals."""

import pytest

pytest.importorskip("pymavlink")

from ptnsbc_io.mavlink.autopilots import ARDUPILOT, GENERIC, advice, refusal


def test_what_a_lab_should_know_before_it_flies():
    warned = list(advice({"COM_OBL_RC_ACT": 0.0, "COM_OF_LOSS_T": 0.05, "NAV_DLL_ACT": 2.0}, 50))
    assert [line.partition("=")[0] for line in warned] == [
        "COM_OBL_RC_ACT", "COM_OF_LOSS_T", "NAV_DLL_ACT"
    ]  # fmt: skip
    assert list(advice({"COM_OBL_RC_ACT": 5.0, "COM_OF_LOSS_T": 1.0}, 50)) == []
    assert "GUID_OPTIONS=8" in refusal(ARDUPILOT, {"GUID_OPTIONS": 0.0}, "attitude")
    assert refusal(ARDUPILOT, {"GUID_OPTIONS": 8.0}, "attitude") is None
    assert "attitude targets only" in refusal(GENERIC, {}, "velocity")
