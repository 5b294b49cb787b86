"""The 3-D scene: ground, robots, aerial units, shape, and who controls whom.

Nodes are made once; a step changes their places, lines and images. x points east, y north, z up; metres.
Nodes of robots and units are named `/robots/ID` and `/units/NUMBER`.
"""

from collections import deque
from collections.abc import Callable
from itertools import combinations
from typing import TYPE_CHECKING

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from skyherd.control import fit_similarity, owners_by_robot
from skyherd.datasets import Mission
from skyherd.drawing.palette import INK, MUTED, TEMPLATE_COLOR, rgb, unit_rgb
from skyherd.errors import DegenerateSetError
from skyherd.geometry import Array, Image, RgbImage, to_complex, to_points
from skyherd.loop import Step
from skyherd.markers.dictionary import QUIET_ZONE_CELLS, cells_per_side, marker_cells
from skyherd.render import Camera, rotation_camera_world

if TYPE_CHECKING:
    import viser

GROUND_PX = 1024
"""Resolution of the ground's picture, px. Chosen: 6 cm a pixel in the scenario `star`, 0.2 MB as JPEG."""

GROUND_SPANS = 2.5
"""Side of the ground over the extent of robots and units. Chosen: robots can be dragged outside."""

PALE = 0.45
"""Share of the ground's contrast and darkness that is shown. Chosen: coloured lines stay legible on it."""

FRUSTUM_PX = 256
"""Largest side of the images in the camera frustums, px. Chosen: the markers are legible."""

TRACE_STEPS = 100
"""Steps in the robots' traces. Chosen: 10 s at the usual time step."""

RING_SIDES, RING_SEGMENTS = 1.05, 24
"""Radius of the ring around a robot, marker sides, and its segments. Chosen: outside the body, round."""

LIFT_M = 0.02
"""Height of lines above the ground, in marker sides. Chosen: no flicker against the ground."""

SRGB_GAMMA = 2.2
"""Exponent from sRGB values to light. Defined by IEC 61966-2-1, to a per cent."""

BODY = (52, 58, 64)
"""Colour of the robots' bodies."""

DEAD = (150, 150, 150)
"""Colour of a dead unit."""

Wxyz = tuple[float, float, float, float]


def wxyz_of(rotation: Array) -> Wxyz:
    """Return the unit quaternion (w, x, y, z) of a rotation matrix (3, 3)."""
    x, y, z, w = Rotation.from_matrix(rotation).as_quat().tolist()
    return w, x, y, z


def wxyz_about_z(angle_rad: float) -> Wxyz:
    """Return the unit quaternion (w, x, y, z) of a rotation about the vertical."""
    return float(np.cos(angle_rad / 2)), 0.0, 0.0, float(np.sin(angle_rad / 2))


FACE_UP: Wxyz = (0.0, 1.0, 0.0, 0.0)
"""Rotation of a picture so that it faces up, its right to +x and its top to +y."""

FACE_UP_AHEAD = wxyz_of(np.array([[0.0, -1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, -1.0]]))
"""Rotation of a picture so that it faces up, its top to +x: forward, in the frame of a robot."""


def ground_picture(mission: Mission) -> tuple[RgbImage, Array, float]:
    """Return the ground as a picture from above, the centre (2,) and the side of what it shows, m."""
    scenario = mission.scenario
    units_m = np.array([unit.position_m for unit in scenario.units])
    places_m = np.concatenate([mission.positions_m, units_m, mission.obstacle_positions_m])
    low, high = places_m.min(axis=0), places_m.max(axis=0)
    heights_m = max(unit.height_m for unit in scenario.units)
    center_m, side_m = (low + high) / 2, GROUND_SPANS * max(float(np.ptp(places_m, axis=0).max()), heights_m)
    ground = scenario.ground.make(scenario.seed, psf_px=scenario.sensor.psf_px, image=mission.ground_image)
    scale = GROUND_PX / side_m
    x, y = center_m.tolist()
    middle = (GROUND_PX - 1) / 2
    homography = np.array([[scale, 0.0, middle - scale * x], [0.0, -scale, middle + scale * y], [0, 0, 1.0]])
    grey = ground.draw(homography, (GROUND_PX, GROUND_PX)).astype(float)
    pale = np.clip(255 - PALE * (255 - grey), 0, 255).astype(np.uint8)
    return np.repeat(pale[..., None], 3, axis=2), center_m, side_m


def marker_picture(dictionary: str, marker_id: int, pixels: int = 8) -> RgbImage:
    """Return the card of a marker: its cells, `pixels` px wide, inside a white margin."""
    margin = round(QUIET_ZONE_CELLS * pixels)
    cells = np.kron(marker_cells(dictionary, marker_id), np.ones((pixels, pixels), dtype=bool))
    grey = np.pad(np.where(cells, 255, 0).astype(np.uint8), margin, constant_values=255)
    return np.repeat(grey[..., None], 3, axis=2)


def reduced(image: Image, largest_px: int = FRUSTUM_PX) -> RgbImage:
    """Return a grey image as RGB, reduced to a largest side, px."""
    scale = min(1.0, largest_px / max(image.shape))
    size = (max(1, round(image.shape[1] * scale)), max(1, round(image.shape[0] * scale)))
    small = cv2.resize(image, size, interpolation=cv2.INTER_AREA)
    return np.asarray(cv2.cvtColor(small, cv2.COLOR_GRAY2RGB))


def field_of_view_rad(camera: Camera, zoom: float) -> float:
    """Return a camera's vertical field of view, rad, without its lens's distortion."""
    return float(2 * np.arctan(camera.size_px[1] / (2 * camera.aspect * camera.focal_px * zoom)))


def chain(points: Array) -> Array:
    """Return the segments (N, 2, 3) of a polyline (N + 1, 3)."""
    return np.stack([points[:-1], points[1:]], axis=1)


def lifted(points_m: Array, height_m: float) -> Array:
    """Return ground points (..., 2) as points (..., 3) at a height."""
    return np.concatenate([points_m, np.full((*points_m.shape[:-1], 1), height_m)], axis=-1)


def _circle() -> Array:
    angles_rad = np.linspace(0.0, 2 * np.pi, RING_SEGMENTS + 1)
    return chain(lifted(np.column_stack([np.cos(angles_rad), np.sin(angles_rad)]), 0.0))


UNIT_CIRCLE = _circle()
"""Segments (RING_SEGMENTS, 2, 3) of a circle of radius 1."""


class Lines:
    """A set of line segments that changes at each step.

    Args:
        scene: the scene of the server.
        name: name of the node.
        thickness_px: width on the screen.
    """

    def __init__(self, scene: "viser.SceneApi", name: str, thickness_px: float) -> None:
        self._node = scene.add_line_segments(
            name,
            np.zeros((1, 2, 3), np.float32),
            np.zeros((1, 2, 3), np.uint8),
            thickness=thickness_px,
            thickness_units="screen",
            visible=False,
        )

    def show(self, segments: Array, colors: Array) -> None:
        """Show segments (N, 2, 3), m, in 8-bit sRGB colours (3,) or (N, 3)."""
        self._node.visible = bool(len(segments))
        if len(segments):
            # viser draws the colours of lines as linear light, unlike those of all other objects.
            linear = np.rint(255 * (np.asarray(colors) / 255) ** SRGB_GAMMA).astype(np.uint8)
            each = np.broadcast_to(linear, (len(segments), 3))
            self._node.points = segments.astype(np.float32)
            self._node.colors = np.repeat(each[:, None], 2, axis=1)


def clicking(choose: Callable[[str], None], name: str) -> Callable[[object], None]:
    """Return a function that ignores the event of a click and chooses an object."""
    return lambda event: choose(name)


class Scene:
    """The 3-D scene of one mission.

    Args:
        server: server of the page.
        mission: mission at its start.
    """

    def __init__(self, server: "viser.ViserServer", mission: Mission) -> None:
        self._server, self._scene = server, server.scene
        self._side_m = mission.scenario.marker.side_m
        self._ids = mission.ids
        self._past_m: deque[Array] = deque(maxlen=TRACE_STEPS)
        self._clickable: list[tuple[str, viser.BoxHandle | viser.ImageHandle]] = []
        self._painted: dict[int, list[viser.BoxHandle]] = {}
        self._scene.reset()
        self._scene.set_up_direction("+z")
        self.center_m, self.extent_m = self._add_ground(mission)
        self._lines = {
            name: Lines(self._scene, f"/lines/{name}", px)
            for name, px in (("traces", 1.5), ("outline", 3.0), ("goals", 1.5), ("rings", 3.0), ("tree", 3.0))
        }
        self._add_obstacles(mission)
        self._robots = [self._add_robot(mission, int(robot)) for robot in mission.ids]
        self._sizes_m = [0.06 * unit.height_m for unit in mission.scenario.units]
        self._units = [self._add_unit(unit) for unit in range(len(self._sizes_m))]
        self._frustums = [self._add_frustum(mission, unit) for unit in range(len(self._sizes_m))]
        self._dead: frozenset[int] = frozenset()
        self._images: dict[int, Image] = {}

    def on_click(self, choose: Callable[[str], None]) -> None:
        """Call a function with `robot ID` or `unit NUMBER` when one is clicked."""
        for name, node in self._clickable:
            node.on_click(clicking(choose, name))

    def view_from(self) -> tuple[tuple[float, float, float], tuple[float, float, float]]:
        """Return the place of the observer and the point looked at, m."""
        x, y = self.center_m.tolist()
        return (x, y - 1.1 * self.extent_m, 0.95 * self.extent_m), (x, y, 0.25 * self.extent_m)

    def clear(self) -> None:
        """Forget the traces and images of the run before."""
        self._past_m.clear()
        self._images.clear()

    @property
    def has_images(self) -> bool:
        """True if a new image waits; each drawing takes one, so that none takes long."""
        return bool(self._images)

    def collect(self, step: Step) -> None:
        """Keep what later drawings need of a step that is not drawn."""
        self._past_m.append(step.positions_m)
        for unit, frame in step.frames.items():
            if frame.sight.image is not None:
                self._images[unit] = frame.sight.image

    def draw(self, step: Step, mission: Mission) -> None:
        """Draw a step, which has been collected, of a mission with the interventions so far."""
        dead = frozenset(mission.scenario.dead_units(step.time_s))
        with self._server.atomic():
            for node, position_m, heading_rad in zip(
                self._robots, step.positions_m.tolist(), step.headings_rad.tolist(), strict=True
            ):
                node.position = (*position_m, 0.0)
                node.wxyz = wxyz_about_z(heading_rad)
            self._draw_units(step, mission, dead)
            self._draw_lines(step, mission, dead)

    def _draw_units(self, step: Step, mission: Mission, dead: frozenset[int]) -> None:
        cameras = mission.cameras_at(step.time_s)
        for unit, (body, frustum) in enumerate(zip(self._units, self._frustums, strict=True)):
            pose = step.fleet.pose(unit)
            place = (*pose.position_m, pose.height_m)
            body.position, body.wxyz = place, wxyz_about_z(pose.yaw_rad)
            frustum.position, frustum.wxyz = place, wxyz_of(rotation_camera_world(pose).T)
            frustum.fov = field_of_view_rad(cameras[unit], pose.zoom)
            if (unit in dead) != (unit in self._dead):
                frustum.visible = unit not in dead
                color = DEAD if unit in dead else unit_rgb(unit)
                for part in self._painted[unit]:
                    part.color = color
        if self._images:
            unit = next(iter(self._images))
            self._frustums[unit].image = reduced(self._images.pop(unit))
        self._dead = dead

    def _draw_lines(self, step: Step, mission: Mission, dead: frozenset[int]) -> None:
        low_m = LIFT_M * self._side_m
        past = np.array(self._past_m)
        traces = lifted(np.stack([past[:-1], past[1:]], axis=2).reshape(-1, 2, 2), low_m)
        self._lines["traces"].show(traces, np.array(rgb(MUTED)))
        goals_m, outline_m = self._shape_m(step, mission)
        purple = np.array(rgb(TEMPLATE_COLOR))
        self._lines["outline"].show(np.concatenate([np.zeros((0, 2, 3)), *map(chain, outline_m)]), purple)
        ways = np.stack([lifted(step.positions_m, low_m), goals_m], axis=1) if len(goals_m) else goals_m
        self._lines["goals"].show(
            np.concatenate([ways, self._circles(goals_m)]) if len(goals_m) else ways, purple
        )
        self._lines["rings"].show(*self._rings(step))
        self._lines["tree"].show(*self._tree(step, dead))

    def _shape_m(self, step: Step, mission: Mission) -> tuple[Array, list[Array]]:
        """Return the robots' points (N, 3) in the best-fitting shape, m, and the shape's lines (M, 3)."""
        template = mission.shape_at(step.time_s, step.roles).points_of(mission.ids).conj()
        try:
            fit = fit_similarity(template, to_complex(step.positions_m))
        except DegenerateSetError:
            return np.zeros((0, 3)), []
        height_m = 2 * LIFT_M * self._side_m
        lines = [lifted(to_points(fit(line.conj())), height_m) for line in mission.outline_at(step.time_s)]
        return lifted(to_points(fit(template)), height_m), lines

    def _circles(self, centers_m: Array, radius_sides: float = 0.35) -> Array:
        """Return the segments of small circles about points (N, 3)."""
        return (centers_m[:, None, None] + radius_sides * self._side_m * UNIT_CIRCLE).reshape(-1, 2, 3)

    def _rings(self, step: Step) -> tuple[Array, Array]:
        """Return the segments of the rings around the robots, and their colours by controlling unit."""
        centers = lifted(step.positions_m, 3 * LIFT_M * self._side_m)
        owners = owners_by_robot(step.control_sets)
        colors = []
        for robot in self._ids.tolist():
            each = [unit_rgb(unit) for unit in owners.get(robot, [])] or [rgb(MUTED)]
            colors += [each[k * len(each) // RING_SEGMENTS] for k in range(RING_SEGMENTS)]
        return self._circles(centers, RING_SIDES), np.array(colors)

    def _tree(self, step: Step, dead: frozenset[int]) -> tuple[Array, Array]:
        """Return a line between each two living units that share at least two robots, and its colour."""
        sets = {unit: set(ids.tolist()) for unit, ids in step.control_sets.items() if unit not in dead}
        pairs = [pair for pair in combinations(sorted(sets), 2) if len(sets[pair[0]] & sets[pair[1]]) >= 2]
        places = np.column_stack([step.fleet.positions_m, step.fleet.heights_m])
        return places[np.array(pairs, dtype=int).reshape(-1, 2)], np.array(rgb(INK))

    def _add_ground(self, mission: Mission) -> tuple[Array, float]:
        picture, center_m, side_m = ground_picture(mission)
        x, y = center_m.tolist()
        self._scene.add_image(
            "/ground", picture, side_m, side_m, format="jpeg", wxyz=FACE_UP, position=(x, y, 0.0)
        )
        return center_m, side_m / GROUND_SPANS

    def _add_obstacles(self, mission: Mission) -> None:
        places = mission.obstacle_positions_m.tolist()
        for marker, (x, y), radius_m, heading_rad in zip(
            mission.obstacle_ids.tolist(), places, mission.obstacle_radii_m.tolist(),
            mission.obstacle_headings_rad.tolist(), strict=True,
        ):  # fmt: skip
            height_m = 0.4 * self._side_m
            self._scene.add_frame(
                f"/obstacles/{marker}", show_axes=False, position=(x, y, 0.0), wxyz=wxyz_about_z(heading_rad)
            )
            self._scene.add_cylinder(
                f"/obstacles/{marker}/body",
                radius_m,
                height_m,
                (120, 110, 100),
                position=(0, 0, height_m / 2),
            )
            self._add_card(mission, f"/obstacles/{marker}/card", marker, 1.02 * height_m)

    def _add_card(self, mission: Mission, name: str, marker: int, height_m: float) -> "viser.ImageHandle":
        """Add the card of a marker, which faces up at a height."""
        dictionary = mission.scenario.marker.dictionary
        card_m = self._side_m * (1 + 2 * QUIET_ZONE_CELLS / cells_per_side(dictionary))
        return self._scene.add_image(
            name,
            marker_picture(dictionary, marker),
            card_m,
            card_m,
            format="png",
            wxyz=FACE_UP_AHEAD,
            position=(0.0, 0.0, height_m),
        )

    def _add_robot(self, mission: Mission, robot: int) -> "viser.FrameHandle":
        """Add a body with two wheels, the marker's card and the number; return the node that moves."""
        side_m, name = self._side_m, f"/robots/{robot}"
        node = self._scene.add_frame(name, show_axes=False)
        body = self._scene.add_box(
            f"{name}/body", BODY, (1.5 * side_m, 1.3 * side_m, 0.35 * side_m), position=(0, 0, 0.3 * side_m)
        )
        for left in (-1, 1):
            self._scene.add_cylinder(
                f"{name}/wheel{left}",
                0.28 * side_m,
                0.16 * side_m,
                (25, 25, 25),
                wxyz=(np.sqrt(0.5), np.sqrt(0.5), 0.0, 0.0),
                position=(0.0, 0.74 * left * side_m, 0.28 * side_m),
            )
        card = self._add_card(mission, f"{name}/card", robot, 0.49 * side_m)
        self._scene.add_label(f"{name}/number", str(robot), position=(0.0, 0.0, 1.6 * side_m))
        self._clickable += [(f"robot {robot}", body), (f"robot {robot}", card)]
        return node

    def _add_unit(self, unit: int) -> "viser.FrameHandle":
        """Add a multicopter: body, two beams, four rotors; return the node that moves."""
        size_m, name, color = self._sizes_m[unit], f"/units/{unit}", unit_rgb(unit)
        node = self._scene.add_frame(name, show_axes=False)
        body = self._scene.add_box(f"{name}/body", color, (0.7 * size_m, 0.5 * size_m, 0.3 * size_m))
        parts = [body]
        for sign in (-1, 1):
            beam = (2.0 * size_m, 0.12 * size_m, 0.1 * size_m)
            turned = wxyz_about_z(sign * np.pi / 4)
            parts.append(self._scene.add_box(f"{name}/beam{sign}", color, beam, wxyz=turned))
        for number, corner in enumerate(np.exp(1j * np.pi * (np.arange(4) / 2 + 0.25))):
            self._scene.add_cylinder(
                f"{name}/rotor{number}",
                0.5 * size_m,
                0.04 * size_m,
                (90, 96, 104),
                opacity=0.55,
                position=(float(size_m * corner.real), float(size_m * corner.imag), 0.12 * size_m),
            )
        self._scene.add_label(f"{name}/number", f"unit {unit}", position=(0.0, 0.0, 0.9 * size_m))
        self._clickable.append((f"unit {unit}", body))
        self._painted[unit] = parts
        return node

    def _add_frustum(self, mission: Mission, unit: int) -> "viser.CameraFrustumHandle":
        model = mission.scenario.units[unit]
        camera = mission.cameras_at(0.0)[unit]
        width, height = camera.size_px
        return self._scene.add_camera_frustum(
            f"/cameras/{unit}",
            field_of_view_rad(camera, 1.0),
            width / height,
            scale=0.11 * model.height_m,
            thickness=2.0,
            thickness_units="screen",
            color=unit_rgb(unit),
            format="jpeg",
        )
