"""The perceptor: one `CameraFrame` in, one `LineSeen` out, in the same loop turn."""

from __future__ import annotations

import math

from robotd import CameraFrame, Perceptor, View, every
from robotd.authoring.explain import Explanation, ImageBox, ImageLine, Scalar, Text
from robotd.world.robot import Robot
from robotd_plugins.perception.floor_line.bar import Arm, Bar
from robotd_plugins.perception.floor_line.config import FloorLineConfig
from robotd_plugins.perception.floor_line.look import Grid, Look, line_in, look
from robotd_plugins.toolkit.floor_view import FloorView
from robotd_plugins.toolkit.line_seen import CrossingBar, LineEnd, LineSeen, RoiLine

_FRESH_S = 0.25
_LEAVES_X = 0.8
"""A line that was last seen farther aside than this goes out of the picture: others may be looked for at once."""
_BOTH_ARMS = 1.0
_ONE_ARM = 0.6


class Sees(View):
    """Each frame that is not older than a quarter of a second."""

    frame: CameraFrame = every(within_s=_FRESH_S)


class FloorLine(Perceptor[FloorLineConfig, Sees, LineSeen]):
    """Adaptive threshold, a trace from the robot's nose upwards, positive evidence for a crossing.

    Publishes a `LineSeen` for every frame, also where nothing is seen: then its `reason` says why. Remembers only where
    the line was, as the middle of the focus mask.
    """

    def __init__(self, config: FloorLineConfig, robot: Robot | None = None) -> None:
        super().__init__(config, robot)
        lens = config.lens
        self._floor = FloorView(self.robot.mount(config.camera), lens.fov_rad, lens.vertical_fov_rad, lens.distortion)
        self._grid = Grid.of(320, 240, config.look_from_share)
        self._last_x = math.nan
        self._last_ns = 0
        self._look: Look | None = None
        self._said: LineSeen | None = None

    @classmethod
    def load(cls, config: FloorLineConfig) -> None:
        import cv2  # noqa: F401  # the import is the work

    def step(self, seen: Sees) -> LineSeen:
        frame, config = seen.frame, self.config
        height, width = frame.bgr.shape[:2]
        if (width, height) != (self._grid.width_px, self._grid.height_px):
            self._grid = Grid.of(width, height, config.look_from_share)
        in_memory = abs(self._last_x) <= _LEAVES_X and frame.stamp_ns - self._last_ns <= config.focus_memory_s * 1e9
        self._look = found = look(frame.bgr, self._grid, config, self._last_x if in_memory else None)
        self._said = said = self._message(found, frame)
        if said.near.is_seen:
            self._last_x, self._last_ns = said.near.x, frame.stamp_ns
        return said

    def explain(self) -> Explanation:
        if self._said is None or self._look is None:
            return ()
        said, found, grid = self._said, self._look, self._grid
        width, height = said.width_px, said.height_px
        drawn: list[ImageBox | ImageLine | Scalar | Text] = [Text("floor_line", said.reason)]
        for name, roi in (("EXECUTION_ROI", said.near), ("LOOKAHEAD_ROI", said.far)):
            drawn.append(ImageBox(name, (0.0, roi.top * height, float(width), roi.bottom * height)))
            if roi.is_seen:
                drawn.append(Scalar(f"{name} x", roi.x))
        if found.trace is not None:
            pieces = found.trace.pieces[::4]
            line = tuple((p.centre * width / grid.width, grid.row_share(p.row) * height) for p in pieces)
            drawn.append(ImageLine("line", line))
        if said.bar is not None:
            ends = [
                end
                for end in (said.bar.left_end, (said.bar.x, said.bar.row), said.bar.right_end)
                if not math.isnan(end[0])
            ]
            bar = tuple(((x + 1.0) / 2.0 * width, row * height) for x, row in ends)
            drawn += [ImageLine("bar", bar), Text("exits", said.bar.exits)]
        if said.end is not None:
            x, row = (said.end.x + 1.0) / 2.0 * width, said.end.row * height
            drawn.append(ImageLine("end", ((x - 0.05 * width, row), (x + 0.05 * width, row))))
        if not math.isnan(said.threshold):
            drawn.append(Scalar("threshold", said.threshold, "grey"))
        return tuple(drawn)

    # ----------------------------------------------------------------------------------------- message

    def _message(self, found: Look, frame: CameraFrame) -> LineSeen:
        config, grid = self.config, self._grid
        near = self._roi(found, config.execution_roi_top_share, config.execution_roi_height_share)
        far = self._roi(found, config.lookahead_roi_top_share, config.lookahead_roi_height_share)
        heading = math.atan2(far.left_m - near.left_m, far.ahead_m - near.ahead_m)
        end = None
        if found.end is not None:
            x, row = grid.x(found.end[0]), grid.row_share(found.end[1])
            end = LineEnd(x, row, self._floor_m(x, row)[0])
        return LineSeen(
            frame.stamp_ns,
            near,
            far,
            heading,
            self._bar(found.bar) if found.bar is not None else None,
            end,
            found.bends,
            found.split.ratio * found.floor_grey,
            found.floor_grey,
            found.split.tape_ratio * found.floor_grey,
            grid.width_px,
            grid.height_px,
            frame.source,
            found.reason,
        )

    def _roi(self, found: Look, top: float, height: float) -> RoiLine:
        bottom = top + height
        if found.trace is None:
            return RoiLine(top, bottom)
        grid = self._grid
        centre, width, seen = line_in(found.trace, grid.row(top), grid.row(bottom))
        share = width / grid.width
        if math.isnan(centre) or share * seen < self.config.scan_pixel_threshold_share:
            return RoiLine(top, bottom)
        x = grid.x(centre)
        contrast = min(1.0, (found.split.floor_ratio - found.split.tape_ratio) / 0.4)
        ahead_m, left_m = self._floor_m(x, (top + bottom) / 2.0)
        return RoiLine(top, bottom, x, share, seen * contrast, ahead_m, left_m)

    def _bar(self, bar: Bar) -> CrossingBar:
        grid = self._grid
        x, row = grid.x(bar.column), grid.row_share(bar.row)

        def end_of(arm: Arm | None) -> tuple[float, float]:
            if arm is None:
                return math.nan, math.nan
            return grid.x(arm.outer_column + 0.5), grid.row_share(arm.outer_row - 0.5)

        both = bar.left is not None and bar.right is not None
        return CrossingBar(
            x,
            row,
            bar.left is not None,
            bar.right is not None,
            bar.straight,
            _BOTH_ARMS if both else _ONE_ARM,
            self._floor_m(x, row)[0],
            end_of(bar.left),
            end_of(bar.right),
        )

    def _floor_m(self, x: float, row: float) -> tuple[float, float]:
        return self._floor.floor_m(x, row, self._grid.width_px / self._grid.height_px)
