"""Messages to bytes and back without rclpy: what `raw=True` publishers and subscriptions carry."""

from ptnsbc_io.wire.cdr import Stamped, WireError
from ptnsbc_io.wire.messages import (
    MOST_NEAR_OBJECTS,
    NEAR_FIELDS,
    ODOMETRY_SIZE,
    Diagnostics,
    DiagnosticStatus,
    HeaderFields,
    HeaderTemplate,
    OdometryDecoder,
    OdometryTemplate,
    Row,
    RowTemplate,
    VelocityTemplate,
    WrenchTemplate,
    checked_near,
    checked_velocity,
    checked_wrench,
    decode_clock,
    decode_diagnostics,
    decode_floats,
    decode_header,
    decode_integers,
    decode_near,
    decode_odometry,
    decode_velocity,
    decode_wrench,
    encode_clock,
    encode_near,
    peek_sequence_stamp,
    peek_stamp,
    transform_of,
)

__all__ = [
    "MOST_NEAR_OBJECTS", "NEAR_FIELDS", "ODOMETRY_SIZE", "DiagnosticStatus", "Diagnostics",
    "HeaderFields", "HeaderTemplate", "OdometryDecoder", "OdometryTemplate", "Row", "RowTemplate", "Stamped",
    "VelocityTemplate", "WireError", "WrenchTemplate", "checked_near", "checked_velocity", "checked_wrench",
    "decode_clock", "decode_diagnostics", "decode_floats", "decode_header", "decode_integers", "decode_near",
    "decode_odometry", "decode_velocity", "decode_wrench", "encode_clock", "encode_near", "peek_sequence_stamp",
    "peek_stamp", "transform_of",
]  # fmt: skip
