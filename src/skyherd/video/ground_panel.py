"""Panel of the ground from above: true positions of robots and units, fields of view, shape."""

import numpy as np

from skyherd.analysis.tree_snapshot import TreeSnapshot
from skyherd.control import fit_similarity, owners_by_robot
from skyherd.datasets import Mission
from skyherd.drawing.canvas import (
    Box,
    Color,
    dashes,
    draw_circle,
    draw_lines,
    draw_ring,
    draw_segments,
    draw_text,
    fill_polygon,
)
from skyherd.drawing.palette import INK, MUTED, PAPER, TEMPLATE_COLOR, rgb, unit_rgb
from skyherd.errors import DegenerateSetError
from skyherd.geometry import Array, RgbImage, to_complex, to_points
from skyherd.loop import Step
from skyherd.render import footprint_m
from skyherd.video.axis_ticks import tick_values
from skyherd.video.body_overlay import CLEAR, BodySizes, draw_bodies, draw_obstacle
from skyherd.video.ground_title import STATE_SIZE_PX, TITLE_SIZE_PX, title_texts
from skyherd.video.tree_overlay import TreeOverlay, draw_dead, draw_pair_marks

TITLE_PX = 26
LEFT_PX = 34
BOTTOM_PX = 22
"""Margins of the map, px: title above, labels of the axes to the left and below."""

FIELD: Color = (248, 248, 246)
GRID: Color = (228, 229, 226)
FAINT: Color = (206, 209, 212)
"""Colours of the map, of its grid, and of the paths of the whole run."""

TAILS: tuple[tuple[int, Color], ...] = ((60, (184, 188, 193)), (30, (150, 156, 163)), (12, (112, 119, 128)))
"""Numbers of last steps of a path, and their colours over the faint path of the whole run."""

LABEL_SPOTS = np.array([[33.0, 0.0], [-33.0, 0.0], [0.0, -18.0], [0.0, 18.0]])
"""Candidate positions of a unit's name around its cross, u and v, the preferred one first."""

LABEL_ROOM_PX = np.array([34.0, 18.0])
"""Half extent of a unit's name along u and v, px; nearer items would be covered."""

EXCHANGE_S = 2.0
"""Simulated time for which a robot's role is shown as newly exchanged, s."""

MIN_EXTENT_M = 1e-3
"""Minimum extent of the view, m, so that a single static robot has one."""

MARGIN = 0.1
"""Margin around the robots and their shape, as a share of the map. Chosen: holds marks and names."""

CLOSER = 1.3
"""Enlargement from which the view moves closer. Chosen: rarer moves, and the robots fill 3/4 of the map."""

FOLLOWING = 0.15
"""Share of the way to its aim by which the view moves in a frame. Chosen: it arrives within a second."""

SETTLED_PX = 1.0
"""Distance from its aim at which the view rests, px. Chosen: not visible."""

OUTLINE_PX = 5
"""Width of the shape's outline, px. Chosen: visible in a video shown 390 px wide."""

PATH_SHARE, VIEW_SHARE = 0.2, 0.5
"""Shares of a unit's colour in its path and in the border of its view. Chosen: both stay behind the shape."""


def pale(color: Color, share: float) -> Color:
    """Return a mixture of a colour and the field's."""
    r, g, b = (round(share * own + (1 - share) * field) for own, field in zip(color, FIELD, strict=True))
    return r, g, b


class GroundPanel:
    """Drawing of steps into a panel of the canvas; the view follows the robots and their shape.

    Args:
        mission: mission of the run.
        panel: the part of the canvas to draw in.
    """

    def __init__(self, mission: Mission, panel: RgbImage) -> None:
        self.mission, self._panel = mission, panel
        box = Box(
            left=LEFT_PX,
            top=TITLE_PX,
            width=panel.shape[1] - LEFT_PX,
            height=panel.shape[0] - TITLE_PX - BOTTOM_PX,
        )
        self._field = box.of(panel)
        self._paper = np.empty_like(self._field)
        self._past_m: list[Array] = []
        self._center_m, self._px_per_m = np.zeros(2), 0.0
        self._aim_m, self._aim_px_per_m = np.zeros(2), 0.0
        self._roles, self._exchanged_s = np.arange(mission.ids.size), np.full(mission.ids.size, -np.inf)
        self._label_sides = [0] * len(mission.scenario.units)
        self._tree = TreeOverlay(mission.ids)
        self._title = panel[:TITLE_PX]

    def to_panel(self, points_m: Array) -> Array:
        """Map ground points (..., 2) to the panel: x to the right, y up."""
        middle = np.array([self._field.shape[1] - 1, self._field.shape[0] - 1]) / 2
        return np.asarray((points_m - self._center_m) * (self._px_per_m, -self._px_per_m) + middle)

    def draw(
        self, step: Step, tree: TreeSnapshot | None = None, struck: frozenset[int] = frozenset()
    ) -> None:
        """Draw the ground at one step.

        Args:
            step: the next one in the order of time.
            tree: the tree of units, if they form one.
            struck: ids of robots and obstacles whose bodies overlap.
        """
        self._write_title(tree)
        cameras = self.mission.cameras_at(step.time_s)
        corners_m = [footprint_m(camera, step.fleet.pose(unit)) for unit, camera in enumerate(cameras)]
        self._past_m.append(np.concatenate([step.positions_m, step.fleet.positions_m]))
        shape_m = self._shape_m(step)
        if self._follow(np.concatenate([step.positions_m, *shape_m])):
            self._draw_paper()
        else:
            self._extend_paths(self._past_m[-2:])
        self._field[:] = self._paper
        self._draw_bodies(step, struck)
        self._draw_tails(step.positions_m.shape[0])
        dead = frozenset[int]() if tree is None else tree.dead
        for unit, corners in enumerate(corners_m):
            if unit not in dead:
                draw_lines(
                    self._field, [self.to_panel(corners)], pale(unit_rgb(unit), VIEW_SHARE), closed=True
                )
        if tree is not None:
            units, robots = self.to_panel(step.fleet.positions_m), self.to_panel(step.positions_m)
            self._tree.draw_edges(self._field, tree, units, robots, step.time_s)
        self._draw_shape(step, shape_m)
        self._draw_robots(step, tree)
        self._draw_units(step, tree)

    def _write_title(self, tree: TreeSnapshot | None) -> None:
        """Draw the title on the left, and the state of the tree on the right."""
        self._title[:] = rgb(PAPER)
        width_px = self._title.shape[1] - LEFT_PX - 2
        title, state = (
            ("the ground from above · axes in metres", "") if tree is None else title_texts(tree, width_px)
        )
        draw_text(self._title, title, (LEFT_PX, TITLE_PX / 2), rgb(INK), size_px=TITLE_SIZE_PX)
        right = self._title.shape[1] - 2, TITLE_PX / 2
        draw_text(self._title, state, right, rgb(INK), size_px=STATE_SIZE_PX, bold=True, align="right")

    def _follow(self, points_m: Array) -> bool:
        """Move the view towards one that frames points (N, 2), and return whether it moved.

        The aim changes only when a point nears the edge or the points fill too little, so that the view rests
        most of the time.
        """
        room = np.array([self._field.shape[1], self._field.shape[0]], dtype=float)
        low, high = points_m.min(axis=0), points_m.max(axis=0)
        extent_m = np.maximum(high - low, MIN_EXTENT_M)
        px_per_m = float((room * (1 - 2 * MARGIN) / extent_m).min())
        edge_m = room * (0.5 - MARGIN / 2) / self._aim_px_per_m if self._aim_px_per_m else np.zeros(2)
        is_inside = bool((np.abs(np.stack([low, high]) - self._aim_m) <= edge_m).all())
        if not is_inside or px_per_m > CLOSER * self._aim_px_per_m:
            self._aim_m, self._aim_px_per_m = (low + high) / 2, px_per_m
        before = self._center_m, self._px_per_m
        share = FOLLOWING if self._px_per_m else 1.0
        self._center_m = self._center_m + share * (self._aim_m - self._center_m)
        self._px_per_m += share * (self._aim_px_per_m - self._px_per_m)
        is_near = np.abs(self._aim_m - self._center_m).max() * self._aim_px_per_m < SETTLED_PX
        if is_near and abs(self._aim_px_per_m / self._px_per_m - 1) * room.max() < SETTLED_PX:
            self._center_m, self._px_per_m = self._aim_m, self._aim_px_per_m
        return bool((before[0] != self._center_m).any()) or before[1] != self._px_per_m

    def _draw_paper(self) -> None:
        """Draw grid, axes, and the paths so far in the new view."""
        height, width = self._field.shape[:2]
        self._paper[:] = FIELD
        span = np.array([width, height]) / 2 / self._px_per_m
        low, high = self._center_m - span, self._center_m + span
        step = tick_values(0.0, float(2 * span.min()), 6)[1]
        bottom, left = self._panel[TITLE_PX + height :], self._panel[TITLE_PX:, :LEFT_PX]
        bottom[:], left[:] = rgb(PAPER), rgb(PAPER)
        for x in np.arange(np.ceil(low[0] / step), np.floor(high[0] / step) + 1) * step + 0.0:
            u = self.to_panel(np.array([x, 0.0]))[0]
            draw_lines(self._paper, [[[u, 0], [u, height]]], GRID)
            if 12 <= u <= width - 12:
                draw_text(bottom, f"{x:g}", (LEFT_PX + u, 11), rgb(MUTED), size_px=12, align="center")
        for y in np.arange(np.ceil(low[1] / step), np.floor(high[1] / step) + 1) * step + 0.0:
            v = self.to_panel(np.array([0.0, y]))[1]
            draw_lines(self._paper, [[[0, v], [width, v]]], GRID)
            draw_text(left, f"{y:g}", (LEFT_PX - 5, v), rgb(MUTED), size_px=12, align="right")
        self._extend_paths(self._past_m)

    def _extend_paths(self, points_m: list[Array]) -> None:
        """Add the faint paths through the last positions (T, N + U, 2)."""
        places = np.moveaxis(self.to_panel(np.array(points_m)), 0, 1)
        robots = self.mission.ids.size
        draw_lines(self._paper, places[:robots], FAINT)
        for unit, path in enumerate(places[robots:]):
            draw_lines(self._paper, [path], pale(unit_rgb(unit), PATH_SHARE))

    def _draw_tails(self, robots: int) -> None:
        for steps, color in TAILS:
            recent = np.array(self._past_m[-steps:])[:, :robots]
            draw_lines(self._field, np.moveaxis(self.to_panel(recent), 0, 1), color)

    def _shape_m(self, step: Step) -> list[Array]:
        """Return the robots' points (N, 2) in the best-fitting shape, m, and then the shape's lines."""
        template = self.mission.shape_at(step.time_s, step.roles).points_of(self.mission.ids).conj()
        try:
            fit = fit_similarity(template, to_complex(step.positions_m))
        except DegenerateSetError:
            return []
        lines = (line.conj() for line in self.mission.outline_at(step.time_s))
        return [to_points(fit(points)) for points in (template, *lines)]

    def _draw_shape(self, step: Step, shape_m: list[Array]) -> None:
        """Draw the lines of the best-fitting shape, each robot's point in it, and the way there."""
        self._exchanged_s[step.roles != self._roles] = step.time_s
        self._roles = step.roles
        if not shape_m:
            return
        draw_lines(self._field, map(self.to_panel, shape_m[1:]), rgb(TEMPLATE_COLOR), OUTLINE_PX)
        places = self.to_panel(shape_m[0])
        robots, is_new = self.to_panel(step.positions_m), step.time_s < self._exchanged_s + EXCHANGE_S
        draw_segments(self._field, *dashes(robots, places), rgb(TEMPLATE_COLOR))
        draw_segments(self._field, *dashes(robots[is_new], places[is_new]), rgb(TEMPLATE_COLOR), 3)
        for place, new in zip(places.tolist(), is_new.tolist(), strict=True):
            draw_circle(self._field, place, 6.0, rgb(TEMPLATE_COLOR if new else PAPER), -1)
            draw_circle(self._field, place, 6.0, rgb(TEMPLATE_COLOR), 1)

    def _draw_bodies(self, step: Step, struck: frozenset[int]) -> None:
        """Draw obstacles, and bodies and safety margins under the robots' marks."""
        mission, px_per_m = self.mission, self._px_per_m
        centers = self.to_panel(mission.obstacle_positions_m)
        radii_m = mission.obstacle_radii_m.tolist()
        for center, radius_m, obstacle in zip(centers, radii_m, mission.obstacle_ids.tolist(), strict=True):
            draw_obstacle(self._field, center, radius_m * px_per_m, 0.0, struck=obstacle in struck)
        if not mission.bodies.radius_m:
            return
        robots, side_px = self.to_panel(step.positions_m), mission.scenario.marker.side_m * px_per_m
        sizes = BodySizes.of(mission)
        if sizes.safety:
            for robot in robots.tolist():
                draw_circle(self._field, robot, sizes.safety * side_px, CLEAR, -1)
        draw_bodies(self._field, robots, sizes.radius * side_px, np.isin(mission.ids, list(struck)))

    def _draw_units(self, step: Step, tree: TreeSnapshot | None) -> None:
        places, robots = self.to_panel(step.fleet.positions_m), self.to_panel(step.positions_m)
        for unit, place in enumerate(places):
            u, v = place.tolist()
            others = np.concatenate([robots, np.delete(places, unit, axis=0)])
            at, halo = self._label_place(unit, place, others), rgb(PAPER)
            if tree is not None and unit in tree.dead:
                draw_dead(self._field, (u, v), 7, rgb(MUTED))
                name, ink = f"unit {unit} dead", rgb(MUTED)
            else:
                cross = [[[u - 8, v], [u + 8, v]], [[u, v - 8], [u, v + 8]]]
                draw_lines(self._field, cross, rgb(PAPER), 8)
                draw_lines(self._field, cross, unit_rgb(unit), 3)
                outside = " outside" if tree is not None and unit in tree.unjoined else ""
                name, ink = f"unit {unit}{outside}", rgb(INK)
            draw_text(self._field, name, at, ink, size_px=12, bold=True, align="center", halo=halo)

    def _label_place(self, unit: int, place: Array, others: Array) -> tuple[float, float]:
        """Return the position of a unit's name beside its cross; it changes only if occupied."""
        spots = place + LABEL_SPOTS
        room = np.linalg.norm((others - spots[:, None]) / LABEL_ROOM_PX, axis=2).min(axis=1)
        if room[self._label_sides[unit]] < 1:
            self._label_sides[unit] = int(room.argmax())
        u, v = spots[self._label_sides[unit]].tolist()
        return u, v

    def _draw_robots(self, step: Step, tree: TreeSnapshot | None) -> None:
        """Draw discs with ids, ringed in the colours of their units, noses ahead."""
        radius = max(9.5, 0.5 * self.mission.scenario.marker.side_m * self._px_per_m)
        places = self.to_panel(step.positions_m)
        owners = owners_by_robot(step.control_sets)
        if tree is not None:
            draw_pair_marks(self._field, tree.links, self.mission.ids, places, radius)
        nose = np.array([radius + 6, (radius - 2) * np.exp(0.7j), (radius - 2) * np.exp(-0.7j)])
        noses = places[:, None] + to_points(np.exp(-1j * step.headings_rad)[:, None] * nose)
        for robot_id, (u, v), corners in zip(self.mission.ids.tolist(), places.tolist(), noses, strict=True):
            fill_polygon(self._field, corners, rgb(INK))
            draw_circle(self._field, (u, v), radius + 1, rgb(PAPER), -1)
            colors = [unit_rgb(unit) for unit in owners.get(robot_id, [])]
            draw_ring(self._field, (u, v), radius - 0.5, colors or [rgb(MUTED)], 3)
            draw_text(self._field, str(robot_id), (u, v), rgb(INK), size_px=11, bold=True, align="center")
