"""Frames of the video: camera images, the ground from above, and curves of V and scale, side by side."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from skyherd.analysis.goal_points import outline_px
from skyherd.analysis.tree_snapshot import TreeHistory
from skyherd.datasets import Mission
from skyherd.drawing.canvas import Box, draw_text, text_width
from skyherd.drawing.palette import INK, MUTED, PAPER, rgb, unit_rgb
from skyherd.geometry import RgbImage
from skyherd.loop import Step, UnitFrame, dead_units
from skyherd.video.body_overlay import BodySizes, overlapping_ids
from skyherd.video.camera_panel import BORDER_PX, TITLE_PX, CameraPanel
from skyherd.video.curve_panel import Curve, CurvePanel
from skyherd.video.ground_panel import GroundPanel
from skyherd.video.legend import draw_legend, legend_height_px
from skyherd.video.rectified_panel import RectifiedPanel

HEADER_PX = 46
"""Height of the line with name, time and figures at the top, px."""

PLOTS_SHARE = 0.25
"""Height of the curves at the bottom, as a share of the frame's."""

CAMERAS_SHARE = 0.62
"""Maximum width of the camera block, as a share of the frame's; the ground has the rest."""

STRIPS_PX = (0, *range(80, 320, 24))
"""Candidate heights of a strip with the legend below the cameras, px; 0 means no strip."""

GAP_PX = 14
"""Distance between panels."""

MUCH_LARGER = 1.2
"""Minimum enlargement of cameras that justifies another column. A wide block leaves less width to the ground
and more of the frame empty."""

MAX_RECTIFIED = 3
"""Maximum number of units with rectified images; more do not fit."""

MAX_NAMED = 5
"""Maximum number of units with named curves; with more the names are bare numbers."""

MIN_COST = 1e-9
"""Threshold below which V, m², is not shown: that of units with two robots, which always fit, or none."""


@dataclass(frozen=True)
class Layout:
    """Positions of all parts on the canvas.

    Attributes:
        cameras: a cell for each camera image.
        rectified: a cell for each rectified image; empty if these are not shown.
        key: the legend.
        ground: the ground from above.
        plots: the curves of V, and of the scales.
    """

    cameras: list[Box]
    rectified: list[Box]
    key: Box
    ground: Box
    plots: tuple[Box, Box]


def make_layout(
    size_px: tuple[int, int],
    image_sizes_px: Sequence[tuple[int, int]],
    *,
    tree: bool = False,
    bodies: bool = False,
    rectified: bool = False,
) -> Layout:
    """Lay out a frame: cameras in a near-square block on the left, the ground beside it, curves below.

    With rectified images each camera has a column. The legend is placed in the free space of the block's last
    row, or else below the block. Among all fitting blocks, the one with the largest images is chosen.

    Args:
        size_px: width and height of the frame.
        image_sizes_px: width and height of each camera's images.
        tree: include the symbols of the tree of units in the legend.
        bodies: include the symbols of bodies in the legend.
        rectified: show the rectified images as well.
    """
    width, height = size_px
    units, square = len(image_sizes_px), int(np.ceil(np.sqrt(len(image_sizes_px))))
    choices = (square, square + 1)
    if rectified:
        image_sizes_px, choices, square = [*image_sizes_px, *image_sizes_px], (units, units), units
    bottom = height - round(PLOTS_SHARE * height)
    blocks = [
        _block(columns, (width, bottom), image_sizes_px, strip_px, tree=tree, bodies=bodies)
        for columns in choices
        for strip_px in STRIPS_PX
    ]
    pitch_u, pitch_v, columns, key = max(
        (block for block in blocks if block),
        key=lambda block: block[0] if block[2] == square else block[0] / MUCH_LARGER,
    )
    corners = [
        (GAP_PX + k % columns * pitch_u, HEADER_PX + k // columns * pitch_v)
        for k in range(len(image_sizes_px))
    ]
    cells = [Box(left=u, top=v, width=pitch_u - GAP_PX, height=pitch_v - GAP_PX) for u, v in corners]
    left = 2 * GAP_PX + columns * pitch_u
    ground = Box(left=left, top=HEADER_PX, width=width - left - GAP_PX, height=bottom - HEADER_PX)
    half = (width - 3 * GAP_PX) // 2
    plots = tuple(
        Box(left=u, top=bottom + 4, width=half, height=height - bottom - 4)
        for u in (GAP_PX, width - GAP_PX - half)
    )
    return Layout(
        cameras=cells[:units], rectified=cells[units:], key=key, ground=ground, plots=(plots[0], plots[1])
    )


def _block(
    columns: int,
    room_px: tuple[int, int],
    image_sizes_px: Sequence[tuple[int, int]],
    strip_px: int,
    *,
    tree: bool,
    bodies: bool,
) -> tuple[int, int, int, Box] | None:
    """Return cell pitches, px, columns, and a box for the key; None if the key does not fit.

    The key is in a strip below the cells, or beside the last row's if that strip is 0 px high.
    """
    width, bottom = room_px
    units = len(image_sizes_px)
    rows = -(-units // columns)
    aspect = max(w / h for w, h in image_sizes_px)
    frame = 2 * BORDER_PX
    high = (bottom - HEADER_PX - strip_px) / rows - TITLE_PX - frame - GAP_PX
    wide = min(high * aspect, CAMERAS_SHARE * width / columns - frame - GAP_PX)
    pitch_u, pitch_v = int(wide) + frame + GAP_PX, int(wide / aspect) + TITLE_PX + frame + GAP_PX
    below = HEADER_PX + rows * pitch_v
    if strip_px:
        key = Box(
            left=GAP_PX, top=below - GAP_PX // 2, width=columns * pitch_u - GAP_PX, height=bottom - below
        )
    else:
        filled = units - (rows - 1) * columns
        left = GAP_PX + filled * pitch_u
        key = Box(
            left=left,
            top=below - pitch_v,
            width=(columns - filled) * pitch_u - GAP_PX,
            height=pitch_v - GAP_PX,
        )
    fits = wide > 0 and key.width > 0 and legend_height_px(key.width, tree=tree, bodies=bodies) <= key.height
    return (pitch_u, pitch_v, columns, key) if fits else None


class Composer:
    """Composer of a video frame for each step of a mission, in the order of time.

    Args:
        mission: mission of the run.
        size_px: width and height of the pictures, px.
    """

    def __init__(self, mission: Mission, size_px: tuple[int, int] = (1600, 1000)) -> None:
        scenario = mission.scenario
        self.mission, self.size_px = mission, size_px
        self._canvas = np.empty((size_px[1], size_px[0], 3), np.uint8)
        self._canvas[:] = rgb(PAPER)
        self._shown = self._canvas.view()
        self._shown.setflags(write=False)
        sizes = [unit.camera.size_px for unit in scenario.units]
        tree = scenario.selection.kind == "tree"
        self._bodies = BodySizes.of(mission)
        bodies = bool(self._bodies.radius or self._bodies.obstacles or scenario.roles.exchange)
        bent = scenario.control.rectify and not all(unit.ideal for unit in scenario.units)
        layout = make_layout(
            size_px, sizes, tree=tree, bodies=bodies, rectified=bent and len(sizes) <= MAX_RECTIFIED
        )
        self._cameras = [
            CameraPanel(unit, box.of(self._canvas), sizes[unit], scenario.selection.radius, self._bodies)
            for unit, box in enumerate(layout.cameras)
        ]
        self._rectified = [
            RectifiedPanel(unit, box.of(self._canvas), sizes[unit])
            for unit, box in enumerate(layout.rectified)
        ]
        self._ground = GroundPanel(mission, layout.ground.of(self._canvas))
        draw_legend(layout.key.of(self._canvas), tree=tree, bodies=bodies)
        self._cost, self._scale = self._make_plots(layout)
        self._last: dict[int, UnitFrame] = {}
        self._tree = TreeHistory()

    def compose(self, step: Step) -> RgbImage:
        """Return the picture (height, width, 3) RGB of a step: read-only, overwritten by the next call."""
        self._last |= step.frames
        dead = dead_units(self.mission.scenario, step.time_s)
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
                self._rectified[unit].draw(frame)
        self._ground.draw(step, self._tree.add(step, dead), struck)
        seen = step.metrics
        cost = np.append(seen.V, seen.V_units)
        self._cost.add(step.time_s, np.where(cost > MIN_COST, cost, np.nan))
        self._scale.add(step.time_s, seen.scales)
        self._draw_header(step)
        return self._shown

    def _make_plots(self, layout: Layout) -> tuple[CurvePanel, CurvePanel]:
        duration_s = self.mission.scenario.duration_s
        many = len(self._cameras) > MAX_NAMED
        names = [f"{unit}" if many else f"unit {unit}" for unit in range(len(self._cameras))]
        units = [Curve(name, unit_rgb(unit)) for unit, name in enumerate(names)]
        cost, scale = (box.of(self._canvas) for box in layout.plots)
        return (
            CurvePanel(cost, "cost V, m²", [Curve("total", rgb(INK), 4), *units], duration_s, log=True),
            CurvePanel(scale, "scale, m per template unit", units, duration_s),
        )

    def _draw_header(self, step: Step) -> None:
        """Draw the mission on the left, and its figures on the right in fixed columns."""
        header = self._canvas[:HEADER_PX]
        header[:] = rgb(PAPER)
        scenario, middle = self.mission.scenario, HEADER_PX / 2
        name = f"skyherd · {scenario.name}"
        draw_text(header, name, (GAP_PX, middle), rgb(INK), size_px=21, bold=True)
        after = GAP_PX + text_width(name, 21, bold=True) + 14
        draw_text(header, scenario.perception, (after, middle), rgb(MUTED), size_px=18)
        right = header.shape[1] - GAP_PX
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
