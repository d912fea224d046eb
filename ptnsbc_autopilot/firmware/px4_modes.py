"""PX4's modes as in HEARTBEAT, and the messages that it streams by default."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

from ptnsbc_io.mavlink.dialect import mavlink


class Px4Mode(NamedTuple):
    """A flight mode as in custom_mode."""

    name: str
    main: int
    sub: int = 0

    @property
    def word(self) -> int:
        """custom_mode of HEARTBEAT."""
        return self.main << 16 | self.sub << 24


MANUAL, ALTCTL, POSCTL = Px4Mode("MANUAL", 1), Px4Mode("ALTCTL", 2), Px4Mode("POSCTL", 3)
TAKEOFF, HOLD, RTL, LAND = (
    Px4Mode("TAKEOFF", 4, 2),
    Px4Mode("HOLD", 4, 3),
    Px4Mode("RTL", 4, 5),
    Px4Mode("LAND", 4, 6),
)
OFFBOARD, STABILIZED = Px4Mode("OFFBOARD", 6), Px4Mode("STABILIZED", 7)
DESCEND = Px4Mode("DESCEND", 4, 6)  # shown as LAND: HEARTBEAT has no number for it
MODES = (MANUAL, ALTCTL, POSCTL, TAKEOFF, HOLD, RTL, LAND, OFFBOARD, STABILIZED)
MANUAL_MODES = (MANUAL, ALTCTL, POSCTL, STABILIZED)
TRANSIENT_MODES = (TAKEOFF, RTL, LAND)  # they end when the motors stop
NEED_POSITION = (POSCTL, TAKEOFF, HOLD, RTL, LAND)

OFFBOARD_LOSS = {0: POSCTL, 1: ALTCTL, 2: STABILIZED, 3: RTL, 4: LAND, 5: HOLD}
"""COM_OBL_RC_ACT; 6 terminates, 7 disarms."""

RATES_HZ: tuple[Mapping[int, float], Mapping[int, float]] = (
    {
        mavlink.MAVLINK_MSG_ID_HEARTBEAT: 1.0,
        mavlink.MAVLINK_MSG_ID_ATTITUDE: 100.0,
        mavlink.MAVLINK_MSG_ID_ATTITUDE_QUATERNION: 50.0,
        mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED: 30.0,
        mavlink.MAVLINK_MSG_ID_ODOMETRY: 30.0,
        mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: 10.0,
        mavlink.MAVLINK_MSG_ID_GPS_RAW_INT: 5.0,
        mavlink.MAVLINK_MSG_ID_SYS_STATUS: 5.0,
        mavlink.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: 5.0,
        mavlink.MAVLINK_MSG_ID_ESTIMATOR_STATUS: 1.0,
        mavlink.MAVLINK_MSG_ID_SYSTEM_TIME: 1.0,
        mavlink.MAVLINK_MSG_ID_TIMESYNC: 10.0,
        mavlink.MAVLINK_MSG_ID_BATTERY_STATUS: 0.5,
        mavlink.MAVLINK_MSG_ID_HOME_POSITION: 0.5,
    },
    {
        mavlink.MAVLINK_MSG_ID_HEARTBEAT: 1.0,
        mavlink.MAVLINK_MSG_ID_ATTITUDE: 10.0,
        mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED: 1.0,
        mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: 5.0,
        mavlink.MAVLINK_MSG_ID_GPS_RAW_INT: 1.0,
        mavlink.MAVLINK_MSG_ID_SYS_STATUS: 1.0,
        mavlink.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: 1.0,
        mavlink.MAVLINK_MSG_ID_BATTERY_STATUS: 0.5,
        mavlink.MAVLINK_MSG_ID_HOME_POSITION: 0.5,
    },
)
"""Per link: a companion's and a ground station's. https://docs.px4.io/main/en/mavlink/"""
