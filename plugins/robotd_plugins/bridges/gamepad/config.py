"""Which stick and button does what."""

from __future__ import annotations

from pydantic import Field

from robotd import Config


class GamepadTeleopConfig(Config):
    """Parameters of driving by hand. A button that is null does nothing; the dead-man's button is the device's."""

    topic: str = "gamepad"
    """The topic of the pad's state; another one where the device is renamed with `as:`."""
    forward_axis: str = "y"
    """Away from the person is forward: the left stick."""
    turn_axis: str = "rx"
    """To the left turns to the left: the right stick. A car steers with it."""
    side_axis: str = "x"
    """To the left drives to the left, on bases that can."""
    speed_share: float = Field(default=0.5, gt=0.0, le=1.0)
    """Share of the robot's limits that a stick at its end asks for."""
    turn_share: float = Field(default=0.5, gt=0.0, le=1.0)
    """The same for turning; of a car's steering angle all of it is used."""
    lease_s: float = Field(default=0.3, ge=0.1, le=1.0)
    """Each command holds for so long; renewed three times in that while the dead-man's button is held."""
    within_s: float = Field(default=0.25, ge=0.05, le=1.0)
    """A pad that said nothing for so long counts as let go."""
    estop_button: str | None = "east"
    """Trips the e-stop, whether the dead-man's button is held or not."""
    arm_button: str | None = "start"
    """Arms the robot, or disarms it where it is armed."""
    reset_button: str | None = "select"
    """Resets the e-stop."""
    resume_button: str | None = "mode"
    """Gives the robot back to its behaviours."""
