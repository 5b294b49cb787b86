"""Annotated pictures of detections and rejections, legible at any image size.

Small images are enlarged by an integer factor, and lines and letters grow with large ones.
"""

from collections.abc import Sequence

import cv2
import numpy as np
import numpy.typing as npt

from skyherd.drawing.canvas import Color, draw_arrows, draw_lines, draw_text, fill_polygon, text_width
from skyherd.drawing.palette import PAPER, UNIT_COLORS, rgb
from skyherd.geometry import Array, RgbImage, to_points
from skyherd.messages import Detections
from skyherd.vision import Reason, Rejection

FOUND_COLOR, REJECTED_COLOR, PLAIN_COLOR = rgb(UNIT_COLORS[0]), rgb(UNIT_COLORS[1]), rgb(UNIT_COLORS[6])
"""Colours of detections, of rejections, and of dark quadrilaterals without bits."""

MIN_SIDE_PX = 640
"""Default minimum of the longer side of an annotated picture, px. Chosen: ids are legible."""

FULL_SIDE_PX = 1280
"""Longer side, px, beyond which lines and letters grow in proportion. Chosen: a usual screen's width."""

FONT_PX, LINE_PX = 15, 2
"""Height of letters and width of lines, px, in pictures of up to `FULL_SIDE_PX`. Chosen to be legible."""

ARROW_SIDES, MIN_ARROW_PX = 0.45, 14
"""Length of the forward arrows, in marker sides, and their minimum length, px. Chosen: short beside the
marker."""

LABEL_REACH_SIDES = 0.72
"""Distance of a label from the centre, in marker sides. Derived: slightly more than half of a square's
diagonal."""


PREFERENCE = 1e-6
"""Penalty of each further label position, in hidden pixels; the first of equal positions wins."""


class Annotator:
    """Drawing of detections and rejections on images of one size.

    Args:
        size_px: width and height of the images to be annotated.
        min_side_px: minimum longer side; smaller images are enlarged by an integer factor.

    Attributes:
        zoom: enlargement factor.
        scale: factor of line widths and font sizes.
    """

    def __init__(self, size_px: tuple[int, int], *, min_side_px: int = MIN_SIDE_PX) -> None:
        longer = max(size_px)
        self.zoom = max(1, -(-min_side_px // longer))
        self.scale = max(1.0, longer * self.zoom / FULL_SIDE_PX)
        self.font_px, self.line_px = round(FONT_PX * self.scale), round(LINE_PX * self.scale)

    def draw(
        self, image: npt.NDArray[np.uint8], detections: Detections, rejections: Sequence[Rejection] = ()
    ) -> RgbImage:
        """Return an RGB copy of a grey image, `zoom` times as large, with detections and rejections.

        Detections have an outline, an arrow forward and their id. Rejections have an outline, and a number
        and a reason unless they are dark quadrilaterals without bits.
        """
        enlarged = cv2.resize(image, None, fx=self.zoom, fy=self.zoom, interpolation=cv2.INTER_NEAREST)
        picture = np.asarray(cv2.cvtColor(enlarged, cv2.COLOR_GRAY2RGB), dtype=np.uint8)
        likely = [r for r in rejections if r.reason is not Reason.NO_BITS]
        plain = [r for r in rejections if r.reason is Reason.NO_BITS]
        self._outline(picture, [r.corners_px for r in plain], PLAIN_COLOR, max(1, self.line_px // 2))
        self._outline(picture, [r.corners_px for r in likely], REJECTED_COLOR, self.line_px)
        self._outline(picture, list(detections.corners_px), FOUND_COLOR, self.line_px)
        self._arrows(picture, detections)
        self._label(picture, detections, likely)
        return picture

    def _shown(self, points_px: Array) -> Array:
        """Return points (..., 2) of the image in the enlarged picture, px."""
        return np.asarray((points_px + 0.5) * self.zoom - 0.5)

    def _outline(self, picture: RgbImage, squares_px: list[Array], color: Color, width_px: int) -> None:
        """Draw lines just outside the squares."""
        for corners in squares_px:
            shown = self._shown(corners)
            center = shown.mean(axis=0)
            reach = float(np.linalg.norm(shown - center, axis=1).mean())
            draw_lines(
                picture, [center + (shown - center) * (1 + width_px / reach)], color, width_px, closed=True
            )

    def _arrows(self, picture: RgbImage, detections: Detections) -> None:
        """Draw forward arrows, from the middles of the front edges outwards."""
        ahead = to_points(np.exp(1j * detections.headings_rad))
        sides = detections.sides_px[:, None] * self.zoom
        lengths = np.maximum(ARROW_SIDES * sides, MIN_ARROW_PX * self.scale)
        starts = self._shown(detections.centers_px) + sides / 2 * ahead
        draw_arrows(picture, starts, starts + lengths * ahead, FOUND_COLOR, rgb(PAPER), scale=self.scale)

    def _label(self, picture: RgbImage, detections: Detections, rejections: list[Rejection]) -> None:
        """Draw ids beside the markers, away from their arrows; number and reason beside rejections."""
        centers = [*detections.centers_px, *(r.center_px for r in rejections)]
        if not centers:
            return
        centers_px = self._shown(np.array(centers))
        reaches = (
            self.zoom * np.array([*detections.sides_px, *(r.side_px for r in rejections)]) * LABEL_REACH_SIDES
        )
        texts = [str(marker_id) for marker_id in detections.ids.tolist()]
        texts += [f"{k + 1}: {r.reason.value}" for k, r in enumerate(rejections)]
        away = [*(detections.headings_rad + np.pi), *(np.pi / 2 for _ in rejections)]
        colors = [FOUND_COLOR] * len(detections) + [REJECTED_COLOR] * len(rejections)
        taken = np.column_stack([centers_px - reaches[:, None], centers_px + reaches[:, None]])
        for k, (text, color) in enumerate(zip(texts, colors, strict=True)):
            box = self._place(text, centers_px[k], float(reaches[k]), float(away[k]), taken, picture.shape)
            taken = np.vstack([taken, box])
            self._write(picture, text, box, color)

    def _place(
        self, text: str, center: Array, reach: float, away_rad: float, taken: Array, shape: tuple[int, ...]
    ) -> Array:
        """Return a box (left, top, right, bottom) for a text that hides least of the occupied area."""
        half = (
            np.array([text_width(text, self.font_px, bold=True) + 0.6 * self.font_px, 1.5 * self.font_px]) / 2
        )
        turns = away_rad + np.pi / 4 * np.array([0, 1, -1, 2, -2, 3, -3, 4])
        rays = np.column_stack([np.cos(turns), np.sin(turns)])
        far = (reach + self.line_px) * np.maximum(1.0, 1.0 / np.abs(rays).max(axis=1))[:, None] * rays
        middles = center + far + np.sign(np.round(rays, 6)) * half
        limit = np.array([shape[1], shape[0]])
        middles = np.clip(middles, half, np.maximum(limit - half, half))
        boxes = np.column_stack([middles - half, middles + half])
        overlap = np.minimum(boxes[:, None, 2:], taken[None, :, 2:]) - np.maximum(
            boxes[:, None, :2], taken[None, :, :2]
        )
        hidden = overlap.clip(0).prod(axis=2).sum(axis=1)
        return np.asarray(boxes[int(np.argmin(hidden + PREFERENCE * np.arange(turns.size)))])

    def _write(self, picture: RgbImage, text: str, box: Array, color: Color) -> None:
        left, top, right, bottom = box
        fill_polygon(picture, np.array([[left, top], [right, top], [right, bottom], [left, bottom]]), color)
        middle = ((left + right) / 2, (top + bottom) / 2)
        draw_text(picture, text, middle, rgb(PAPER), size_px=self.font_px, bold=True, align="center")
