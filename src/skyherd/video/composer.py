"""Frames of the video: camera images, the ground from above, and curves of V and scale."""

import numpy as np

from skyherd.analysis.goal_points import outline_px, rectified_outline_px
from skyherd.analysis.tree_snapshot import TreeHistory
from skyherd.datasets import Mission
from skyherd.drawing.canvas import Color, draw_text, text_width, wrap_text
from skyherd.drawing.palette import INK, MUTED, PAPER, WARNING, rgb, unit_rgb
from skyherd.geometry import RgbImage
from skyherd.loop import Step, UnitFrame
from skyherd.video.body_overlay import BodySizes, overlapping_ids
from skyherd.video.camera_panel import CameraPanel
from skyherd.video.curve_panel import Curve, CurvePanel
from skyherd.video.ground_panel import GroundPanel
from skyherd.video.layout import SIZE_PX, Layout, make_layout, make_phone_layout
from skyherd.video.legend import draw_legend, legend_items
from skyherd.video.rectified_panel import RectifiedPanel

MIN_COST = 1e-9
"""Threshold below which V, m², is not shown: that of units with two robots, which always fit, or none."""

CAPTION_SIZES_PX = (18, 16, 14, 12)
"""Font sizes of the caption; the largest that fits is taken."""

LINE_HEIGHT = 1.25
"""Distance between two lines of text, in font sizes."""


class Composer:
    """Composer of a video frame for each step of a mission, in the order of time.

    Args:
        mission: mission of the run.
        size_px: width and height of the pictures, px.
        phone: compose narrow pictures for phones instead, as high as they need.
    """

    def __init__(self, mission: Mission, size_px: tuple[int, int] = SIZE_PX, *, phone: bool = False) -> None:
        scenario = mission.scenario
        sizes, items = [unit.camera.size_px for unit in scenario.units], legend_items(mission)
        bent = scenario.control.rectify and not all(unit.ideal for unit in scenario.units)
        if phone:
            layout = make_phone_layout(sizes, items, rectified=bent)
        else:
            layout = make_layout(size_px, sizes, items, rectified=bent)
        self.mission, self.size_px, self._phone = mission, layout.size_px, phone
        self._canvas = np.empty((self.size_px[1], self.size_px[0], 3), np.uint8)
        self._canvas[:] = rgb(PAPER)
        self._shown = self._canvas.view()
        self._shown.setflags(write=False)
        self._bodies = BodySizes.of(mission)
        self._cameras = [
            CameraPanel(unit, box.of(self._canvas), sizes[unit], scenario.selection.radius, self._bodies)
            for unit, box in enumerate(layout.cameras)
        ]
        self._rectified = [
            RectifiedPanel(unit, box.of(self._canvas), sizes[unit])
            for unit, box in enumerate(layout.rectified)
        ]
        self._ground = GroundPanel(mission, layout.ground.of(self._canvas))
        draw_legend(layout.key.of(self._canvas), items)
        self._cost, self._scale = self._make_plots(layout)
        self._header, self._caption = layout.header.of(self._canvas), layout.caption.of(self._canvas)
        self._write_caption(scenario.description, rgb(MUTED))
        self._last: dict[int, UnitFrame] = {}
        self._tree = TreeHistory()

    def compose(self, step: Step) -> RgbImage:
        """Return the picture (height, width, 3) RGB of a step: read-only, overwritten by the next call."""
        self._last |= step.frames
        dead = self.mission.scenario.dead_units(step.time_s)
        for unit in dead:
            self._last.pop(unit, None)
            self._cameras[unit].draw_dead()
        struck = overlapping_ids(self.mission, step.positions_m)
        shape = self.mission.shape_at(step.time_s, step.roles)
        lines = self.mission.outline_at(step.time_s)
        for unit, frame in self._last.items():
            outline = outline_px(frame.decision, shape, lines)
            self._cameras[unit].draw(frame, step.control_sets, struck, outline)
            if self._rectified:
                self._rectified[unit].draw(frame, rectified_outline_px(frame.decision, shape, lines))
        self._ground.draw(step, self._tree.add(step, dead), struck)
        seen = step.metrics
        cost = np.append(seen.V, seen.V_units)
        self._cost.add(step.time_s, np.where(cost > MIN_COST, cost, np.nan))
        self._scale.add(step.time_s, seen.scales)
        self._draw_header(step)
        return self._shown

    def conclude(self, verdict: str, *, is_good: bool) -> RgbImage:
        """Return the last picture with the verdict on the run as its caption."""
        self._write_caption(verdict, rgb(INK if is_good else WARNING), bold=True)
        return self._shown

    def _make_plots(self, layout: Layout) -> tuple[CurvePanel, CurvePanel]:
        duration_s = self.mission.scenario.duration_s
        units = [Curve(unit_rgb(unit)) for unit in range(len(self._cameras))]
        cost, scale = (box.of(self._canvas) for box in layout.plots)
        title = "cost V, m²: total (black), and of each unit"
        return (
            CurvePanel(cost, title, [Curve(rgb(INK), 4), *units], duration_s, log=True),
            CurvePanel(scale, "scale of each unit's shape, m per template unit", units, duration_s),
        )

    def _write_caption(self, text: str, color: Color, *, bold: bool = False) -> None:
        """Draw a text in as many lines as fit, in the largest font."""
        self._caption[:] = rgb(PAPER)
        height, width = self._caption.shape[:2]
        for size_px in CAPTION_SIZES_PX:
            lines = wrap_text(text, width, size_px, bold=bold)
            if LINE_HEIGHT * size_px * len(lines) <= height:
                break
        for row, line in enumerate(lines):
            at = 0.0, (row + 0.5) * LINE_HEIGHT * size_px
            draw_text(self._caption, line, at, color, size_px=size_px, bold=bold)

    def _draw_header(self, step: Step) -> None:
        """Draw the mission on the left, and its figures on the right in fixed columns."""
        header, scenario = self._header, self.mission.scenario
        header[:] = rgb(PAPER)
        middle = header.shape[0] / (4 if self._phone else 2)
        name, size_px = f"skyherd · {scenario.name}", 19 if self._phone else 21
        draw_text(header, name, (0, middle), rgb(INK), size_px=size_px, bold=True)
        speed = scenario.video.speed
        kind = scenario.perception + (f" · {speed:g}× speed" if speed > 1 else "")
        after = text_width(name, size_px, bold=True) + 14
        draw_text(header, kind, (after, middle), rgb(MUTED), size_px=16)
        if self._phone:
            figures = [f"{label} {value}" for label, value, _ in self._figures(step)[:3]]
            draw_text(header, " · ".join(figures), (0, 3 * middle), rgb(INK), size_px=16)
            return
        right = header.shape[1]
        for label, value, width in reversed(self._figures(step)):
            draw_text(header, value, (right - width, middle), rgb(INK), size_px=18, bold=True)
            label_right = right - width - 8
            draw_text(header, label, (label_right, middle), rgb(MUTED), size_px=16, align="right")
            right = round(label_right - text_width(label, 16) - 26)

    def _nearest(self, step: Step) -> tuple[str, str, int]:
        """Return the closest pair of robots, or the least gap between any two bodies."""
        if not (self._bodies.radius or self._bodies.obstacles):
            return "closest pair", f"{step.metrics.min_separation_m:.2f} m", 74
        gap_m = float(self.mission.bodies.gaps_m(step.positions_m).min())
        return "least gap", f"{gap_m:.2f} m".replace("-", "−"), 74

    def _figures(self, step: Step) -> list[tuple[str, str, int]]:
        """Return label, value, and the width in px reserved for the value."""
        seen = step.metrics
        sights = [frame.sight for frame in self._last.values()]
        found = sum(sight.found_ids.size for sight in sights)
        whole = sum(sight.whole_ids.size for sight in sights)
        return [
            ("t", f"{step.time_s:.1f} s", 86),
            ("shape error", f"{100 * seen.shape.error:.1f} %", 74),
            self._nearest(step),
            ("detections", f"{found}/{whole}", 88),
            ("V", f"{seen.V:.3g} m²" if seen.V >= 0.01 else f"{seen.V:.1e} m²", 112),
        ]
