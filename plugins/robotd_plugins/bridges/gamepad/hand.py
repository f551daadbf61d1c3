"""What a hand on a gamepad wants of the robot: pure functions of its state."""

from __future__ import annotations

from collections.abc import Mapping

from robotd import Drive, Steer
from robotd.world.kinematics import Ackermann
from robotd.world.messages import Command, Gamepad
from robotd.world.robot import Robot
from robotd_plugins.bridges.gamepad.config import GamepadTeleopConfig


def command(pad: Gamepad, config: GamepadTeleopConfig, robot: Robot) -> Command:
    """The velocity, or for a car speed and steering angle, that the sticks ask for. REP-103: left is positive."""
    limits, body = robot.limits, robot.kinematics
    forward_mps = -pad.axis(config.forward_axis) * config.speed_share * limits.vx_mps
    turn = -pad.axis(config.turn_axis)
    if isinstance(body, Ackermann):
        return Steer(forward_mps, turn * body.max_steering_rad)
    left_mps = -pad.axis(config.side_axis) * config.speed_share * limits.vy_mps if body.is_holonomic else 0.0
    return Drive(forward_mps, turn * config.turn_share * limits.wz_radps, left_mps)


def standstill(robot: Robot) -> Command:
    """The command that stands still, of the kind that the base takes."""
    return Steer() if isinstance(robot.kinematics, Ackermann) else Drive()


def pressed(before: Mapping[str, int], pad: Gamepad) -> frozenset[str]:
    """Buttons that were pressed since the counts were `before`, held or let go meanwhile."""
    return frozenset(name for name, count in pad.presses if count > before.get(name, 0))
