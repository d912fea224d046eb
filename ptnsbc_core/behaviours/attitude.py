"""Attitude behaviour of the plant with six inputs. The paper does not give this law."""

from __future__ import annotations

from ptnsbc_core.algebra import wrap_angle
from ptnsbc_core.behaviours.contract import EpochErrors
from ptnsbc_core.kernel import kernel
from ptnsbc_core.kinematics import body_rates, euler_from_rotation, rotation
from ptnsbc_core.timebase import Clock, task_rate
from ptnsbc_core.types import AgentConfig, OdometryLike, Vector3


@kernel
def attitude(
    own: OdometryLike, yaw: float, epoch: EpochErrors, clock: Clock, config: AgentConfig
) -> tuple[Vector3, Vector3]:
    """w = W^-1 Lambda G (beta_d - beta) with beta_d = (0, 0, yaw).

    Returns the body rates [rad/s] and the Euler error [rad].
    """
    euler = euler_from_rotation(rotation(own, 3))
    error = (-euler[0], -euler[1], wrap_angle(yaw - euler[2]))
    start_error = error if epoch.at_epoch else epoch.start.attitude
    rate = task_rate(config.attitude, error, start_error, clock)
    return body_rates(euler, rate), error
