"""The 3-D scene: ground, robots, aerial units, shape, and who controls whom.

Nodes are made once; a step changes their places, lines and images. x points east, y north, z up; metres.
Nodes of robots and units are named `/robots/ID` and `/units/NUMBER`.
"""

from collections import deque
from collections.abc import Callable, Sequence
from itertools import combinations
from typing import TYPE_CHECKING

import numpy as np

from skyherd.control import fit_similarity, owners_by_robot
from skyherd.datasets import Mission
from skyherd.drawing.palette import INK, TEMPLATE_COLOR, rgb, unit_rgb
from skyherd.errors import DegenerateSetError
from skyherd.geometry import Array, to_complex, to_points
from skyherd.loop import Step, UnitFrame
from skyherd.play.belief import belief_of
from skyherd.play.bodies import DEAD, UNIT_SIZE, Bodies
from skyherd.play.lines import Lines, chain, circle, circles, lifted
from skyherd.play.pictures import LiveImage, ground_picture
from skyherd.play.poses import (
    FACE_UP,
    VIEW_FOV_RAD,
    Window,
    field_of_view_rad,
    on_grid,
    view_of,
    wxyz_about_z,
    wxyz_of,
)
from skyherd.play.server import set_first_view
from skyherd.render import rotation_camera_world

if TYPE_CHECKING:
    import viser

TRACE_S, TRACE_POINTS = 60.0, 120
"""Time that the robots' traces show, s, and the points of each. Chosen: most of a run; 3840 segments for 32
robots."""

RING_SIDES, GOAL_SIDES = 1.05, 0.35
"""Radii of the ring around a robot and of the circle at its point, marker sides. Chosen: the ring is outside
of the body."""

LIFT_SIDES = 0.02
"""Height of lines above the ground, marker sides. Chosen: no flicker against the ground."""

GRID_SIDES = 1 / 100
"""Upper bound of the grid of drawn places, marker sides. Chosen: far below a pixel of the whole scene."""

GREY = (92, 98, 106)
"""Colour of traces, and of rings around robots that no unit controls. Chosen: contrast of 3 to the ground."""

SEEN_SIDES = 0.7
"""Radius of the ring at the place where a unit believes a robot, marker sides. Chosen: differs from the ring
around the robot."""

LINES = {"traces": 1.5, "outline": 3.0, "ways": 1.5, "tree": 3.0, "belief": 2.0}
"""Sets of lines, and their widths on the screen, px."""

RING_PX, GOAL_PX = 3.0, 1.5
"""Widths of a robot's ring and of the circle at its point, on the screen, px."""


class Scene:
    """The 3-D scene of one mission.

    Args:
        server: server of the page.
        mission: mission at its start.

    Attributes:
        corners_m: (N, 3) points around the robots, obstacles and units at the start.
        believer: unit whose knowledge is shown, or None.
    """

    def __init__(self, server: "viser.ViserServer", mission: Mission) -> None:
        self._server, self._scene = server, server.scene
        self._side_m = mission.scenario.marker.side_m
        self._grid_m = drawn_grid_m(mission)
        self._ids = mission.ids
        self._past_m: deque[Array] = deque(maxlen=TRACE_POINTS)
        self._past_s = -TRACE_S
        self._dead: frozenset[int] = frozenset()
        self._newest: dict[int, tuple[UnitFrame, Step]] = {}
        self.believer: int | None = None
        self._scene.reset()
        self._scene.set_up_direction("+z")
        self._add_ground(mission)
        self._lines = {name: Lines(self._scene, f"/lines/{name}", px) for name, px in LINES.items()}
        bodies = Bodies(self._scene, mission)
        bodies.add_obstacles()
        self._robots: list[viser.FrameHandle] = []
        self._rings: list[Lines] = []
        self._goals: list[Lines] = []
        self._clickable: list[tuple[str, viser.BoxHandle | viser.ImageHandle]] = []
        for robot in mission.ids.tolist():
            node, clickable = bodies.add_robot(robot)
            self._robots.append(node)
            self._rings.append(Lines(self._scene, f"/robots/{robot}/ring", RING_PX))
            self._goals.append(Lines(self._scene, f"/goals/{robot}", GOAL_PX))
            self._clickable += [(f"robot {robot}", part) for part in clickable]
        self._units = [bodies.add_unit(unit) for unit in range(len(mission.scenario.units))]
        self._clickable += [(f"unit {unit}", nodes.painted[0]) for unit, nodes in enumerate(self._units)]
        self.corners_m = corners_m(mission)
        server.initial_camera.fov = VIEW_FOV_RAD
        server.on_client_connect(self._set_view)

    def on_click(self, choose: Callable[[str], None]) -> None:
        """Call a function with `robot ID` or `unit NUMBER` when one is clicked."""
        for name, node in self._clickable:
            node.on_click(clicking(choose, name))

    def _set_view(self, client: "viser.ClientHandle") -> None:
        """Show the whole team in the free part of a browser's window."""
        width_px, height_px = client.camera.image_width, client.camera.image_height
        if width_px > 0 and height_px > 0:
            set_first_view(client, *view_of(self.corners_m, Window.of(width_px, height_px)))

    def clear(self) -> None:
        """Forget the traces of the run before."""
        self._past_m.clear()
        self._past_s = -TRACE_S
        self._newest.clear()

    def collect(self, step: Step) -> None:
        """Keep what later drawings need of a step that is not drawn."""
        self._newest.update({unit: (frame, step) for unit, frame in step.frames.items()})
        if step.time_s - self._past_s >= TRACE_S / TRACE_POINTS:
            self._past_s = step.time_s
            self._past_m.append(self._placed(step.positions_m))

    def draw(self, step: Step, mission: Mission, images: Sequence[LiveImage]) -> None:
        """Draw a step, which has been collected, of a mission with the interventions so far."""
        dead = frozenset(mission.scenario.dead_units(step.time_s))
        with self._server.atomic():
            for node, position_m, heading_rad in zip(
                self._robots, self._placed(step.positions_m).tolist(), step.headings_rad.tolist(), strict=True
            ):
                node.position = (*position_m, 0.0)
                node.wxyz = wxyz_about_z(heading_rad)
            self._draw_units(step, mission, dead)
            self._draw_lines(step, mission, dead)
            self._draw_rings(step)
            for image in images:
                self._units[image.unit].frustum.image = image.plain

    def _placed(self, points_m: Array) -> Array:
        """Return points on the grid of what is drawn."""
        return on_grid(points_m, self._grid_m)

    def _draw_units(self, step: Step, mission: Mission, dead: frozenset[int]) -> None:
        cameras = mission.cameras_at(step.time_s)
        for unit, nodes in enumerate(self._units):
            pose = step.fleet.pose(unit)
            x, y, z = self._placed(np.array([*pose.position_m, pose.height_m])).tolist()
            place = (x, y, z)
            nodes.body.position, nodes.body.wxyz = place, wxyz_about_z(pose.yaw_rad)
            nodes.frustum.position, nodes.frustum.wxyz = place, wxyz_of(rotation_camera_world(pose).T)
            nodes.frustum.fov = field_of_view_rad(cameras[unit], pose.zoom)
            if (unit in dead) != (unit in self._dead):
                nodes.frustum.visible = unit not in dead
                for part in nodes.painted:
                    part.color = DEAD if unit in dead else unit_rgb(unit)
        self._dead = dead

    def _draw_lines(self, step: Step, mission: Mission, dead: frozenset[int]) -> None:
        low_m = LIFT_SIDES * self._side_m
        positions_m = self._placed(step.positions_m)
        past = np.array([*self._past_m, positions_m])
        traces = lifted(np.stack([past[:-1], past[1:]], axis=2).reshape(-1, 2, 2), low_m)
        self._lines["traces"].show(traces, np.array(GREY))
        goals_m, outline_m = self._shape_m(step, mission)
        purple = np.array(rgb(TEMPLATE_COLOR))
        self._lines["outline"].show(np.concatenate([np.zeros((0, 2, 3)), *map(chain, outline_m)]), purple)
        no_lines = np.zeros((0, 2, 3))
        ways = np.stack([lifted(positions_m, low_m), goals_m], axis=1) if len(goals_m) else no_lines
        self._lines["ways"].show(ways, purple)
        goal = circle(GOAL_SIDES * self._side_m, 0.0) if len(goals_m) else no_lines
        for node in self._goals:
            node.show(goal, purple)
        for node, (x, y, z) in zip(self._goals, goals_m.tolist(), strict=False):
            node.move((x, y, z))
        self._lines["belief"].show(*self._belief(mission, dead))
        self._lines["tree"].show(*self._tree(step, dead))

    def _shape_m(self, step: Step, mission: Mission) -> tuple[Array, list[Array]]:
        """Return the robots' points (N, 3) in the best-fitting shape, m, and the shape's lines (M, 3)."""
        template = mission.shape_at(step.time_s, step.roles).points_of(mission.ids).conj()
        try:
            fit = fit_similarity(template, to_complex(step.positions_m))
        except DegenerateSetError:
            return np.zeros((0, 3)), []
        height_m = 2 * LIFT_SIDES * self._side_m
        outline = mission.outline_at(step.time_s)
        lines = [lifted(self._placed(to_points(fit(line.conj()))), height_m) for line in outline]
        return lifted(self._placed(to_points(fit(template))), height_m), lines

    def _belief(self, mission: Mission, dead: frozenset[int]) -> tuple[Array, Array]:
        """Return the segments of a unit's knowledge, and its colour; none if no unit is chosen."""
        unit = self.believer
        belief = None
        if unit is not None and unit in self._newest and unit not in dead:
            belief = belief_of(*self._newest[unit], mission)
        if unit is None or belief is None:
            return np.zeros((0, 2, 3)), np.array(GREY)
        height_m = 4 * LIFT_SIDES * self._side_m
        starts_m, goals_m = lifted(belief.starts_m, height_m), lifted(belief.goals_m, height_m)
        parts = [
            circles(lifted(belief.seen_m, height_m), SEEN_SIDES * self._side_m),
            np.stack([starts_m, goals_m], axis=1),
            circles(goals_m, GOAL_SIDES * self._side_m),
            *(chain(lifted(line, height_m)) for line in belief.outline_m),
        ]
        return np.concatenate(parts), np.array(unit_rgb(unit))

    def _draw_rings(self, step: Step) -> None:
        """Colour the rings around the robots by their controlling units."""
        ring = circle(RING_SIDES * self._side_m, 3 * LIFT_SIDES * self._side_m)
        owners = owners_by_robot(step.control_sets)
        for robot, node in zip(self._ids.tolist(), self._rings, strict=True):
            each = [unit_rgb(unit) for unit in owners.get(robot, [])] or [GREY]
            node.show(ring, np.array([each[k * len(each) // len(ring)] for k in range(len(ring))]))

    def _tree(self, step: Step, dead: frozenset[int]) -> tuple[Array, Array]:
        """Return a line between each two living units that share at least two robots, and its colour."""
        sets = {unit: set(ids.tolist()) for unit, ids in step.control_sets.items() if unit not in dead}
        pairs = [pair for pair in combinations(sorted(sets), 2) if len(sets[pair[0]] & sets[pair[1]]) >= 2]
        places = np.column_stack([step.fleet.positions_m, step.fleet.heights_m])
        return places[np.array(pairs, dtype=int).reshape(-1, 2)], np.array(rgb(INK))

    def _add_ground(self, mission: Mission) -> None:
        picture, center_m, side_m = ground_picture(mission)
        x, y = center_m.tolist()
        self._scene.add_image(
            "/ground", picture, side_m, side_m, format="jpeg", wxyz=FACE_UP, position=(x, y, 0.0)
        )


def drawn_grid_m(mission: Mission) -> float:
    """Return the grid of drawn places, m: the power of two below `GRID_SIDES` marker sides."""
    return float(2.0 ** np.floor(np.log2(GRID_SIDES * mission.scenario.marker.side_m)))


def clicking(choose: Callable[[str], None], name: str) -> Callable[[object], None]:
    """Return a function that ignores the event of a click and chooses an object."""
    return lambda event: choose(name)


def corners_m(mission: Mission) -> Array:
    """Return points (N, 3) around the robots, obstacles and units at the start."""
    low = lifted(np.concatenate([mission.positions_m, mission.obstacle_positions_m]), 0.0)
    high = []
    for unit in mission.scenario.units:
        (x, y), size_m = unit.position_m, 2 * UNIT_SIZE * unit.height_m
        high += [(x + dx, y, unit.height_m + dz) for dx in (-size_m, size_m) for dz in (0.0, size_m)]
    return np.concatenate([low, np.array(high)])
