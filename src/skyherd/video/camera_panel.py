"""Panel of one aerial unit: its camera image, the robots in it, and their desired points."""

from collections.abc import Sequence

import cv2
import numpy as np

from skyherd.analysis.goal_points import desired_points_px, rows_of
from skyherd.control import ControlSets, owners_by_robot
from skyherd.drawing.canvas import (
    Box,
    Color,
    circle_dashes,
    draw_arrows,
    draw_circle,
    draw_lines,
    draw_ring,
    draw_segments,
    draw_text,
    fill_polygon,
    text_width,
)
from skyherd.drawing.palette import INK, MUTED, PAPER, TEMPLATE_COLOR, rgb, unit_rgb
from skyherd.geometry import Array, BoolArray, RgbImage, to_points
from skyherd.loop import UnitFrame
from skyherd.messages import NO_ID, Detections
from skyherd.messages.tree_status import TreeStatus
from skyherd.video.body_overlay import BodySizes, draw_obstacle, draw_safety, draw_warning

TITLE_PX = 26
"""Height of the title above the image."""

BORDER_PX = 3
"""Width of the frame around the image, in the unit's colour."""

PLAIN: Color = (236, 237, 233)
"""Colour of the ground where no image was rendered."""

FOREIGN: Color = (78, 83, 90)
"""Colour of the rings around robots that the unit sees but does not control."""

CLEAR_SIDES = 0.95
"""Radius of the empty area around an obstacle's centre, in marker sides: its marker and card."""

OUTLINE_PX = 2
"""Width of the outline of the desired shape, px."""

RING_PX = 4
"""Distance from a robot's ring to the outer ring of the units that share it, px."""

LIFT = 0.7
"""Exponent of the display curve of camera images. Values below 1 brighten mid greys, so that colours stand
out."""

_CURVE = np.rint(255 * (np.arange(256) / 255) ** LIFT).astype(np.uint8)


def _tree_text(tree: TreeStatus | None) -> str:
    """Return the title text on the unit's position in the tree."""
    if tree is None:
        return ""
    if tree.tree_id == NO_ID:
        return " · outside" if tree.asks_id == NO_ID else f" · asks unit {tree.asks_id}"
    return "" if tree.heir_id == NO_ID else f" · heir {tree.heir_id}"


def brightened(image: RgbImage) -> RgbImage:
    """Apply the display curve of exponent `LIFT` to a grey camera image."""
    return np.asarray(cv2.LUT(image, _CURVE), dtype=np.uint8)


def draw_outline(picture: RgbImage, lines: Sequence[Array]) -> None:
    """Draw lines (M, 2) of the desired shape with a bright rim, px of the picture."""
    draw_lines(picture, lines, rgb(PAPER), OUTLINE_PX + 2)
    draw_lines(picture, lines, rgb(TEMPLATE_COLOR), OUTLINE_PX)


class CameraPanel:
    """Drawing of one unit's frames into its cell of the canvas: a title, and the image below it.

    Args:
        unit: number of the unit.
        cell: the part of the canvas to draw in.
        image_size_px: width and height of the unit's images.
        radius: safety radius, in halves of the image's shorter side.
        bodies: sizes of robots and obstacles; points if None.
    """

    def __init__(
        self,
        unit: int,
        cell: RgbImage,
        image_size_px: tuple[int, int],
        radius: float,
        bodies: BodySizes | None = None,
    ) -> None:
        self.unit, self.color, self.bodies = unit, unit_rgb(unit), bodies or BodySizes()
        width, height = image_size_px
        room = np.array([cell.shape[1], cell.shape[0] - TITLE_PX]) - 2 * BORDER_PX
        self.scale = float(min(room / (width, height)))
        shown = Box(
            left=BORDER_PX,
            top=TITLE_PX + BORDER_PX,
            width=int(width * self.scale),
            height=int(height * self.scale),
        )
        self._title = cell[:TITLE_PX]
        self._picture = shown.of(cell)
        self._grey = np.empty((shown.height, shown.width), np.uint8)
        center_px = self.to_panel(np.array([(width - 1) / 2, (height - 1) / 2]))
        self._circle = circle_dashes(center_px, radius * min(width, height) / 2 * self.scale)
        self._frame = Box(
            left=0, top=TITLE_PX, width=shown.width + 2 * BORDER_PX, height=shown.height + 2 * BORDER_PX
        ).of(cell)
        self._is_dead = False
        self._show_nothing(self.color)
        self._write_title(f"unit {unit} · no image yet")

    @property
    def picture(self) -> RgbImage:
        """Part of the cell with the image, as a view."""
        return self._picture

    def to_panel(self, points_px: Array) -> Array:
        """Map points (..., 2) of the camera's image to the panel."""
        return np.asarray((points_px + 0.5) * self.scale - 0.5)

    def draw(
        self,
        frame: UnitFrame,
        sets: ControlSets,
        struck: frozenset[int] = frozenset(),
        outline_px: Sequence[Array] = (),
    ) -> None:
        """Draw a frame: picture, outline, rings, bodies, goals and ids.

        Args:
            frame: the unit's image and decision.
            sets: robots controlled by each unit, by unit.
            struck: ids of robots and obstacles whose bodies overlap.
            outline_px: lines (M, 2) of the unit's desired shape in its image.
        """
        if self._is_dead:
            self._show_nothing(self.color)
            self._is_dead = False
        seen, report = frame.sight.detections, frame.decision.report
        stones = np.array(list(self.bodies.obstacles), dtype=np.int64)
        robots = seen.select(np.setdiff1d(seen.ids, stones))
        controlled = report.controlled_ids
        controls, in_tree = f"unit {self.unit} · {controlled.size} controlled", _tree_text(report.tree)
        self._write_title(f"{controls} · {len(robots)} seen{in_tree}", f"{controls}{in_tree}")
        self._draw_image(frame)
        plain = frame.sight.image is None
        color = rgb(MUTED if plain else PAPER)
        draw_lines(self._picture, self._seen_circle(frame), color, 2)
        self._draw_obstacles(seen.select(stones), struck)
        draw_outline(self._picture, [self.to_panel(line) for line in outline_px])
        self._draw_marks(robots, {**sets, self.unit: controlled})
        self._draw_bodies(robots, struck, color)
        self._draw_goals(frame)
        self._draw_ids(robots)

    def _seen_circle(self, frame: UnitFrame) -> Array:
        """Return the safety radius as the camera sees it, as dashes (N, 4, 2)."""
        if frame.decision.ground_map.ideal:
            return self._circle
        size_px = frame.sight.detections.image_size_px
        circle = (self._circle.reshape(-1, 2) + 0.5) / self.scale - 0.5
        seen = self.to_panel(frame.decision.ground_map.image_px(circle, size_px))
        return seen.reshape(self._circle.shape)

    def draw_dead(self) -> None:
        """Show that the unit is in an outage, until its next frame is drawn."""
        if not self._is_dead:
            self._is_dead = True
            self._show_nothing(rgb(MUTED))
            height, width = self._picture.shape[:2]
            draw_lines(self._picture, [[[0, 0], [width, height]], [[0, height], [width, 0]]], rgb(MUTED), 2)
            self._write_title(f"unit {self.unit} · dead")

    def _show_nothing(self, frame: Color) -> None:
        self._frame[:] = frame
        self._picture[:] = PLAIN

    def _write_title(self, *texts: str) -> None:
        """Draw the first text that fits, large or small; else the last one, small."""
        self._title[:] = rgb(PAPER)
        draw_circle(self._title, (7, TITLE_PX / 2), 6, self.color, -1)
        room = self._title.shape[1] - 20
        sizes = [(text, size_px) for text in texts for size_px in (15, 12)]
        fitting = (choice for choice in sizes if text_width(*choice) <= room)
        text, size_px = next(fitting, sizes[-1])
        draw_text(self._title, text, (20, TITLE_PX / 2), rgb(INK), size_px=size_px)

    def _draw_image(self, frame: UnitFrame) -> None:
        """Draw the picture, or its markers as black squares without one."""
        image = frame.sight.image
        if image is None:
            self._picture[:] = PLAIN
            for corners in self.to_panel(frame.sight.detections.corners_px):
                fill_polygon(self._picture, corners, (0, 0, 0))
            return
        height, width = self._grey.shape
        # Halving is quick, and means over areas of other sizes take long. Less than a halving needs no means.
        while image.shape[0] >= 2 * height and not (image.shape[0] % 2 or image.shape[1] % 2):
            half = image.shape[1] // 2, image.shape[0] // 2
            image = np.asarray(cv2.resize(image, half, interpolation=cv2.INTER_AREA), dtype=np.uint8)
        cv2.resize(image, (width, height), dst=self._grey, interpolation=cv2.INTER_LINEAR)
        cv2.LUT(self._grey, _CURVE, dst=self._grey)
        cv2.cvtColor(self._grey, cv2.COLOR_GRAY2RGB, dst=self._picture)

    def _draw_obstacles(self, stones: Detections, struck: frozenset[int]) -> None:
        """Draw obstacles, hatched around their markers."""
        centers, sides = self.to_panel(stones.centers_px), stones.sides_px * self.scale
        for stone_id, center, side in zip(stones.ids.tolist(), centers, sides.tolist(), strict=True):
            radius = self.bodies.obstacles[stone_id] * side
            hole = min(CLEAR_SIDES * side, radius)
            draw_obstacle(self._picture, center, radius, hole, struck=stone_id in struck)

    def _draw_bodies(self, robots: Detections, struck: frozenset[int], color: Color) -> None:
        """Draw the robots' safety margins, and overlaps; a robot's own ring shows its body."""
        centers, radii = self.to_panel(robots.centers_px), self._radii(robots)
        clear = self.bodies.safety * robots.sides_px * self.scale
        apart = clear > radii + RING_PX
        draw_safety(self._picture, centers[apart], clear[apart], color)
        hit = np.isin(robots.ids, list(struck))
        for center, radius in zip(centers[hit].tolist(), radii[hit].tolist(), strict=True):
            draw_warning(self._picture, center, radius + RING_PX)

    def _draw_marks(self, robots: Detections, sets: ControlSets) -> None:
        """Draw rings: this unit's colour, then those of the other sharing units; else grey."""
        owners = owners_by_robot(sets)
        units = [owners.get(robot_id, []) for robot_id in robots.ids.tolist()]
        mine = np.array([self.unit in who for who in units], dtype=bool)
        shared = mine & np.array([len(who) > 1 for who in units], dtype=bool)
        centers, radii = self.to_panel(robots.centers_px), self._radii(robots)
        self._draw_ticks(centers, radii + RING_PX * shared, robots.headings_rad, mine)
        for who, center, radius in zip(units, centers.tolist(), radii.tolist(), strict=True):
            own = self.unit in who
            draw_ring(self._picture, center, radius, [self.color if own else FOREIGN])
            others = [unit_rgb(unit) for unit in who if unit != self.unit]
            if own and others:
                draw_ring(self._picture, center, radius + RING_PX, others)

    def _draw_ticks(self, centers: Array, radii: Array, headings_rad: Array, mine: BoolArray) -> None:
        """Draw heading ticks (N,) from the rings outwards."""
        ahead = to_points(np.exp(1j * headings_rad))
        starts, ends = centers + radii[:, None] * ahead, centers + (radii[:, None] + 8) * ahead
        draw_segments(self._picture, starts, ends, rgb(PAPER), 5)
        draw_segments(self._picture, starts[mine], ends[mine], self.color, 3)
        draw_segments(self._picture, starts[~mine], ends[~mine], FOREIGN, 3)

    def _radii(self, robots: Detections) -> Array:
        """Return the ring radii (N,) of robots: their bodies', or outside the marker; not too small."""
        return np.maximum((self.bodies.radius or 0.95) * robots.sides_px * self.scale, 7.0)

    def _draw_goals(self, frame: UnitFrame) -> None:
        if frame.decision.goals is None:
            return
        robots = frame.sight.detections
        starts = self.to_panel(robots.centers_px[rows_of(robots, frame.decision.goals.ids)])
        tips = self.to_panel(desired_points_px(frame.decision))
        draw_arrows(self._picture, starts, tips, rgb(TEMPLATE_COLOR), rgb(PAPER))

    def _draw_ids(self, robots: Detections) -> None:
        places = self.to_panel(robots.centers_px).tolist()
        for robot_id, (u, v), radius in zip(robots.ids.tolist(), places, self._radii(robots), strict=True):
            at = u + 0.75 * radius + 4, v - 0.75 * radius - 5
            draw_text(self._picture, str(robot_id), at, rgb(INK), size_px=12, bold=True, halo=rgb(PAPER))
