"""Messages to bytes and back without rclpy: what `raw=True` publishers and subscriptions carry."""

from ptnsbc_io.wire.arrays import Row, RowTemplate, decode_floats, decode_integers
from ptnsbc_io.wire.cdr import Stamped, WireError
from ptnsbc_io.wire.checks import (
    OdometryDecoder,
    checked_near,
    checked_velocity,
    checked_wrench,
)
from ptnsbc_io.wire.diagnostics import Diagnostics, DiagnosticStatus, decode_diagnostics
from ptnsbc_io.wire.odometry import ODOMETRY_SIZE, OdometryTemplate, decode_odometry
from ptnsbc_io.wire.pointcloud import NEAR_FIELDS, decode_near, encode_near
from ptnsbc_io.wire.stamped import (
    ClockTemplate,
    HeaderFields,
    HeaderTemplate,
    VelocityTemplate,
    WrenchTemplate,
    decode_clock,
    decode_header,
    decode_velocity,
    decode_wrench,
    peek_sequence_stamp,
    peek_stamp,
)
from ptnsbc_io.wire.transform import transform_of

__all__ = [
    "WireError",
    "Stamped",
    "HeaderFields",
    "ODOMETRY_SIZE",
    "NEAR_FIELDS",
    "OdometryTemplate",
    "decode_odometry",
    "VelocityTemplate",
    "decode_velocity",
    "WrenchTemplate",
    "decode_wrench",
    "HeaderTemplate",
    "decode_header",
    "ClockTemplate",
    "decode_clock",
    "encode_near",
    "decode_near",
    "transform_of",
    "Row",
    "RowTemplate",
    "decode_integers",
    "decode_floats",
    "peek_stamp",
    "peek_sequence_stamp",
    "DiagnosticStatus",
    "Diagnostics",
    "decode_diagnostics",
    "OdometryDecoder",
    "checked_near",
    "checked_velocity",
    "checked_wrench",
]
