"""Panel of a unit's image, rectified to an ideal camera by the learned ground map."""

from collections.abc import Sequence

import cv2
import numpy as np
import numpy.typing as npt

from skyherd.analysis.goal_points import rectified_goals_px, rows_of
from skyherd.control import GroundMap
from skyherd.drawing.canvas import (
    Box,
    draw_arrows,
    draw_circle,
    draw_lines,
    draw_text,
    fill_polygon,
    text_width,
)
from skyherd.drawing.palette import INK, PAPER, TEMPLATE_COLOR, rgb, unit_rgb
from skyherd.geometry import Array, RgbImage
from skyherd.loop import UnitFrame
from skyherd.messages import Detections
from skyherd.video.camera_panel import BORDER_PX, PLAIN, TITLE_PX, brightened, draw_outline

Float = npt.NDArray[np.float32]

KNOT_PX = 8
"""Knot spacing of the map on the panel, px; linear interpolation between knots is accurate to 0.1 px of the
panel."""


class RectifiedPanel:
    """Drawing of one unit's rectified frames into its cell of the canvas: title, and image below.

    Args:
        unit: number of the unit.
        cell: the part of the canvas to draw in.
        image_size_px: width and height of the unit's images.
    """

    def __init__(self, unit: int, cell: RgbImage, image_size_px: tuple[int, int]) -> None:
        width, height = image_size_px
        room = np.array([cell.shape[1], cell.shape[0] - TITLE_PX]) - 2 * BORDER_PX
        self.unit, self.color, self.size_px = unit, unit_rgb(unit), np.array(image_size_px)
        self.scale = float(min(room / (width, height)))
        shown = Box(
            left=BORDER_PX,
            top=TITLE_PX + BORDER_PX,
            width=int(width * self.scale),
            height=int(height * self.scale),
        )
        self._title, self._picture = cell[:TITLE_PX], shown.of(cell)
        Box(left=0, top=TITLE_PX, width=shown.width + 2 * BORDER_PX, height=shown.height + 2 * BORDER_PX).of(
            cell
        )[:] = self.color
        self._picture[:] = PLAIN
        self._write_title("rectified · no image yet")

    def to_panel(self, points_px: Array) -> Array:
        """Map points (..., 2) of the rectified image to the panel."""
        return np.asarray((points_px + 0.5) * self.scale - 0.5)

    def draw(self, frame: UnitFrame, outline_px: Sequence[Array] = ()) -> None:
        """Draw a frame. With a correct map, all markers are squares of one size.

        Args:
            frame: the unit's image and decision.
            outline_px: lines (M, 2) of the unit's desired shape in the rectified image.
        """
        seen = frame.sight.detections
        robots = frame.decision.detections
        self._write_title(*_titles(seen, robots, learned=not frame.decision.ground_map.ideal))
        corners = self.to_panel(robots.corners_px)
        if frame.sight.image is None:
            self._picture[:] = PLAIN
            for square in corners:
                fill_polygon(self._picture, square, (0, 0, 0))
        else:
            self._draw_image(frame.sight.image, frame.decision.ground_map)
        draw_outline(self._picture, [self.to_panel(line) for line in outline_px])
        draw_lines(self._picture, list(corners), self.color, 2, closed=True)
        if frame.decision.goals is not None:
            starts = robots.centers_px[rows_of(robots, frame.decision.goals.ids)]
            tips = self.to_panel(rectified_goals_px(frame.decision))
            draw_arrows(self._picture, self.to_panel(starts), tips, rgb(TEMPLATE_COLOR), rgb(PAPER))

    def _draw_image(self, image: RgbImage, ground_map: GroundMap) -> None:
        height, width = self._picture.shape[:2]
        u, v = (np.arange(0, length + KNOT_PX, KNOT_PX, dtype=float) for length in (width, height))
        knots = np.stack(np.meshgrid(u, v), axis=-1)
        places = (knots.reshape(-1, 2) + 0.5) / self.scale - 0.5
        there = ground_map.image_px(places, self.size_px).reshape(knots.shape)
        fine = _between(there.astype(np.float32), (width, height))
        grey = cv2.remap(
            brightened(image), fine[..., 0], fine[..., 1], cv2.INTER_LINEAR, borderValue=float(np.mean(PLAIN))
        )
        cv2.cvtColor(grey, cv2.COLOR_GRAY2RGB, dst=self._picture)

    def _write_title(self, *texts: str) -> None:
        """Draw the first text that fits, else the last one."""
        self._title[:] = rgb(PAPER)
        draw_circle(self._title, (7, TITLE_PX / 2), 6, self.color, -1)
        room = self._title.shape[1] - 20
        fitting = (text for text in texts if text_width(text, 13) <= room)
        draw_text(self._title, next(fitting, texts[-1]), (20, TITLE_PX / 2), rgb(INK), size_px=13)


def _between(knots: Float, size_px: tuple[int, int]) -> Float:
    """Interpolate linearly between knots `KNOT_PX` apart; return values (height, width, 2)."""
    width, height = size_px
    u, v = np.meshgrid(np.arange(width), np.arange(height))
    where = (u / KNOT_PX).astype(np.float32), (v / KNOT_PX).astype(np.float32)
    return np.asarray(cv2.remap(knots, *where, cv2.INTER_LINEAR), dtype=np.float32)


def _titles(seen: Detections, robots: Detections, *, learned: bool) -> list[str]:
    """Return texts on the effect of rectification: the spread of marker sizes before and after."""
    if not learned or len(seen) < 2:
        return ["rectified: as seen"]
    before, after = (f"{100 * np.std(d.sides_px) / np.mean(d.sides_px):.2g} %" for d in (seen, robots))
    return [f"rectified · sizes ± {after}, seen ± {before}", f"rectified · sizes ± {after}"]
