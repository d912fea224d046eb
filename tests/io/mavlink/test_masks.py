"""Type masks by field name, against the ones that real autopilots were seen to accept."""

import pytest

from ptnsbc_io.mavlink import masks


@pytest.mark.parametrize(
    ("used", "mask"),
    [
        ((*masks.VELOCITY, "yaw_rate"), 0x05C7),  # both were tried on PX4
        (("vx", "vy", "z", "yaw_rate"), 0x05E3),
        ((*masks.VELOCITY, "yaw"), 0x09C7),
        ((*masks.POSITION, *masks.VELOCITY, "yaw"), 0x09C0),
        ((*masks.VELOCITY, *masks.ACCELERATION, "yaw"), 0x0807),
        ((*masks.POSITION, "yaw"), 0x09F8),
    ],
)
def test_position_target_masks(used, mask):
    assert masks.position_target(used) == mask


def test_attitude_target_masks():
    assert masks.attitude_target(("q", "thrust")) == 0b00000111
    assert masks.attitude_target(("q", "thrust", *masks.RATES)) == 0
    assert masks.attitude_target((*masks.RATES, "thrust")) == 0b10000000


def test_a_setpoint_never_means_force():
    assert masks.position_target(masks.ACCELERATION) & 0x200 == 0


@pytest.mark.parametrize("used", [(), ("vx", "speed")])
def test_nothing_and_unknown_fields_are_refused(used):
    with pytest.raises(masks.MaskError, match="expected some of x, y, z"):
        masks.position_target(used)
