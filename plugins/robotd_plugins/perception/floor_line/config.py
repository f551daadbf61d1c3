"""Parameters of the perceptor `floor_line`; the names of the seed stand in docs/behaviours/jetbot_route.md."""

from __future__ import annotations

from pydantic import Field, model_validator

from robotd import Config
from robotd_plugins.toolkit.floor_view import LensConfig


class FloorLineConfig(Config):
    """Where to look for the line and what counts as one. Rows are shares of the picture's height from its top."""

    execution_roi_top_share: float = Field(default=0.85, ge=0.0, lt=1.0)
    """Upper row of the near region, by which the robot steers (EXECUTION_ROI)."""
    execution_roi_height_share: float = Field(default=0.15, gt=0.0, le=1.0)
    """Height of the near region."""
    lookahead_roi_top_share: float = Field(default=0.60, ge=0.0, lt=1.0)
    """Upper row of the far region, which tells the line's direction (LOOKAHEAD_ROI)."""
    lookahead_roi_height_share: float = Field(default=0.15, gt=0.0, le=1.0)
    """Height of the far region."""
    look_from_share: float = Field(default=0.45, ge=0.0, le=0.8)
    """Rows above this one are not looked at: horizon, walls, furniture."""
    roi_center_width_share: float = Field(default=0.5, gt=0.05, le=1.0)
    """Width of the focus mask as a share of the picture's; its middle is where the line is expected."""
    focus_memory_s: float = Field(default=0.5, ge=0.0, le=5.0)
    """For this long after the line was last seen the focus mask stays; then the whole width is searched."""
    scan_pixel_threshold_share: float = Field(default=0.0075, gt=0.0, le=0.5)
    """The line must cover at least this share of a region, else it is not seen there (SCAN_PIXEL_THRESHOLD)."""
    line_v_max: int | None = Field(default=None, ge=1, le=255)
    """Tape is never brighter than this grey level, on top of the adaptive threshold; null: adaptive alone."""
    line_width_min_share: float = Field(default=0.02, gt=0.0, le=0.5)
    """The narrowest thing that counts as the line at the bottom of the picture, as a share of its width."""
    line_width_max_share: float = Field(default=0.40, gt=0.0, le=0.45)
    """The widest thing that counts as the line."""
    ratio_min: float = Field(default=0.50, gt=0.0, lt=1.0)
    """Lower bound of the adaptive threshold, as a share of the floor's brightness."""
    ratio_max: float = Field(default=0.74, gt=0.0, lt=1.0)
    """Upper bound of the adaptive threshold, as a share of the floor's brightness."""
    floor_grey_min: float = Field(default=30.0, ge=0.0, le=255.0)
    """A floor darker than this is too dark to see a line on."""
    bar_arm_share: float = Field(default=0.11, gt=0.02, le=0.5)
    """A bar must reach at least this share of the picture's width beyond the line's side."""
    bar_lowest_share: float = Field(default=0.88, gt=0.0, le=1.0)
    """A bar below this row is no longer looked for: it is under the robot's nose."""
    camera: str = "camera"
    """Name of the camera whose mount (`robot: mounts:`) tells metres; without a height there are none."""
    lens: LensConfig = Field(default_factory=LensConfig)

    @model_validator(mode="after")
    def _regions_are_in_the_picture(self) -> FloorLineConfig:
        for name, top, height in (
            ("execution_roi", self.execution_roi_top_share, self.execution_roi_height_share),
            ("lookahead_roi", self.lookahead_roi_top_share, self.lookahead_roi_height_share),
        ):
            if top + height > 1.0 + 1e-9:
                raise ValueError(
                    f"{name}: top {top} and height {height} reach below the picture; their sum is at most 1"
                )
            if top < self.look_from_share:
                raise ValueError(f"{name}: its top {top} is above look_from_share {self.look_from_share}")
        if self.lookahead_roi_top_share >= self.execution_roi_top_share:
            raise ValueError("lookahead_roi must lie above execution_roi: lower lookahead_roi_top_share")
        if self.ratio_min >= self.ratio_max:
            raise ValueError(f"ratio_min {self.ratio_min} must be below ratio_max {self.ratio_max}")
        return self
