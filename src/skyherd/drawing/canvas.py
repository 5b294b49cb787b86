"""Drawing on RGB images: anti-aliased shapes with sub-pixel positions, and text.

Points are (u, v) in pixels of the image drawn on, u right, v down, an integer being a pixel centre.
Images are RGB (height, width, 3), drawn on in place. They may be views of a larger one: drawing is clipped to
the view.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from importlib.util import find_spec
from pathlib import Path
from typing import Literal

import cv2
import numpy as np
import numpy.typing as npt
from PIL import Image as PillowImage
from PIL import ImageDraw, ImageFont

from skyherd.geometry import RgbImage

Color = tuple[int, int, int]
"""Red, green and blue, 0 to 255."""

Align = Literal["left", "center", "right"]
"""Anchor point of a text."""

_SHIFT = 4
"""Fractional bits of OpenCV's fixed-point coordinates. *Chosen*: 1/16 px, finer than anti-aliasing shows."""

_ONE = 1 << _SHIFT
"""One pixel in these coordinates. *Derived*."""

_FAR_PX = 1e5
"""Limit to which points farther out are clamped, px. *Chosen*: far outside any image, without fixed-point
overflow."""

_CAP_HEIGHT = 0.729
"""Height of DejaVu Sans capitals and digits over the font size. *Derived* from the font: 1493 of 2048
units."""

_POINT_PX = 1e-9
"""Length below which an arrow is a point, px. *Chosen*: avoids division by zero."""


@dataclass(frozen=True)
class Box:
    """A rectangle of an image: its left and top pixel, its width and height, px."""

    left: int
    top: int
    width: int
    height: int

    def of(self, image: RgbImage) -> RgbImage:
        """Return the part of the image in the box, as a view."""
        return image[self.top : self.top + self.height, self.left : self.left + self.width]


def _fixed(points_px: npt.ArrayLike) -> npt.NDArray[np.int32]:
    """Return points as OpenCV's fixed-point numbers, clamped far outside the image."""
    # This runs a hundred times a frame; `clip` takes twice as long as both bounds by themselves.
    points = np.minimum(np.maximum(np.asarray(points_px, dtype=np.float64), -_FAR_PX), _FAR_PX)
    fixed: npt.NDArray[np.int32] = np.rint(points * _ONE).astype(np.int32, order="C")
    return fixed


def _fixed_point(point_px: Sequence[float]) -> tuple[int, int]:
    u, v = point_px
    return round(u * _ONE), round(v * _ONE)


def draw_lines(
    image: RgbImage,
    lines_px: npt.NDArray[np.float64] | Iterable[npt.ArrayLike],
    color: Color,
    width_px: int = 1,
    *,
    closed: bool = False,
) -> None:
    """Draw polylines, each with points (M, 2); `closed` joins their ends.

    Lines that have as many points as each other are drawn fastest as one array (N, M, 2).
    """
    lines = list(_fixed(lines_px) if isinstance(lines_px, np.ndarray) else map(_fixed, lines_px))
    if lines:
        cv2.polylines(image, lines, closed, color, width_px, cv2.LINE_AA, _SHIFT)


def draw_segments(
    image: RgbImage, starts_px: npt.ArrayLike, ends_px: npt.ArrayLike, color: Color, width_px: int = 1
) -> None:
    """Draw straight lines from points (N, 2) to points (N, 2)."""
    draw_lines(image, np.stack([starts_px, ends_px], axis=1), color, width_px)


def fill_polygon(image: RgbImage, points_px: npt.ArrayLike, color: Color) -> None:
    """Fill a polygon with corners (M, 2)."""
    cv2.fillPoly(image, [_fixed(points_px)], color, cv2.LINE_AA, _SHIFT)


def draw_circle(
    image: RgbImage, center_px: Sequence[float], radius_px: float, color: Color, width_px: int = 1
) -> None:
    """Draw a circle, or a disc if `width_px` is -1."""
    center = _fixed_point(center_px)
    cv2.circle(image, center, round(radius_px * _ONE), color, width_px, cv2.LINE_AA, _SHIFT)


def draw_ring(
    image: RgbImage, center_px: Sequence[float], radius_px: float, colors: Sequence[Color], width_px: int = 2
) -> None:
    """Draw a circle in as many equal arcs as there are colours, clockwise from the left."""
    if len(colors) == 1:
        draw_circle(image, center_px, radius_px, colors[0], width_px)
        return
    center, radius = _fixed_point(center_px), round(radius_px * _ONE)
    arc = 360.0 / len(colors)
    for k, color in enumerate(colors):
        start = 180.0 + k * arc
        cv2.ellipse(image, center, (radius, radius), start, 0.0, arc, color, width_px, cv2.LINE_AA, _SHIFT)


def dashes(
    starts_px: npt.ArrayLike, ends_px: npt.ArrayLike, dash_px: float = 4.0
) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    """Cut lines (N, 2) to (N, 2) into dashes as long as the gaps; return starts and ends (M, 2)."""
    starts, ends = np.asarray(starts_px, dtype=float), np.asarray(ends_px, dtype=float)
    lengths = np.linalg.norm(ends - starts, axis=1)
    counts = np.ceil(lengths / (2 * dash_px)).astype(int)
    line = np.repeat(np.arange(lengths.size), counts)
    order = np.arange(counts.sum()) - np.repeat(np.cumsum(counts) - counts, counts)
    first = 2 * dash_px * order / lengths[line]
    last = np.minimum(first + dash_px / lengths[line], 1.0)
    way = (ends - starts)[line]
    return starts[line] + first[:, None] * way, starts[line] + last[:, None] * way


def circle_dashes(
    center_px: npt.ArrayLike, radius_px: float, dash_px: float = 6.0
) -> npt.NDArray[np.float64]:
    """Return the arcs (N, 4, 2) of a dashed circle, polylines of 4 points as long as the gaps."""
    count = max(8, round(np.pi * radius_px / dash_px))
    starts = 2 * np.pi * np.arange(count) / count
    angles = starts[:, None] + np.linspace(0.0, np.pi / count, 4)
    around = np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    return np.asarray(np.asarray(center_px) + radius_px * around, dtype=np.float64)


@lru_cache(maxsize=64)
def _font(size_px: int, bold: bool) -> ImageFont.FreeTypeFont:
    name = "DejaVuSans-Bold.ttf" if bold else "DejaVuSans.ttf"
    # Matplotlib brings the fonts. It is found and not imported, which takes 0.15 s and is for figures only.
    spec = find_spec("matplotlib")
    folder = Path(spec.origin or "").parent if spec else Path()
    return ImageFont.truetype(folder / "mpl-data" / "fonts" / "ttf" / name, size_px)


@lru_cache(maxsize=4096)
def text_width(text: str, size_px: int = 13, *, bold: bool = False) -> float:
    """Return the width of a line of text, px, in a font of `size_px`."""
    return float(_font(size_px, bold).getlength(text))


def wrap_text(text: str, width_px: float, size_px: int = 13, *, bold: bool = False) -> list[str]:
    """Break a text at its spaces into lines of at most `width_px`, px; a longer word has its own line.

    A number and its per cent sign stay together.
    """
    lines: list[str] = []
    for word in text.replace(" %", "\N{NO-BREAK SPACE}%").split(" "):
        longer = f"{lines[-1]} {word}" if lines else word
        if lines and text_width(longer, size_px, bold=bold) <= width_px:
            lines[-1] = longer
        else:
            lines.append(word)
    return lines


@dataclass(frozen=True)
class _Sprite:
    """A text ready for blending, `(image * keep + add) / 256`, and its anchor."""

    keep: npt.NDArray[np.uint16]
    add: npt.NDArray[np.uint16]
    anchor_px: tuple[float, float]


@lru_cache(maxsize=4096)
def _sprite(text: str, size_px: int, bold: bool, align: Align, color: Color, halo: Color | None) -> _Sprite:
    font, pad = _font(size_px, bold), 3
    ascent, descent = font.getmetrics()
    length = text_width(text, size_px, bold=bold)
    mask = PillowImage.new("L", (int(np.ceil(length)) + 2 * pad, ascent + descent + 2 * pad))
    ImageDraw.Draw(mask).text((pad, pad), text, fill=255, font=font)
    ink = np.asarray(mask, dtype=np.float32)[..., None] / np.float32(255)
    add, keep = ink * np.array(color, np.float32), 1 - ink
    if halo is not None:
        disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (5, 5))
        around = cv2.GaussianBlur(cv2.dilate(np.asarray(mask), disc), (3, 3), 0)[..., None] / np.float32(255)
        add, keep = add + keep * around * np.array(halo, np.float32), keep * (1 - around)
    anchor = {"left": 0.0, "center": length / 2, "right": length}[align]
    return _Sprite(
        np.floor(keep * 256).astype(np.uint16),
        np.floor(add * 256).astype(np.uint16),
        (pad + anchor, pad + ascent - size_px * _CAP_HEIGHT / 2),
    )


def draw_text(
    image: RgbImage,
    text: str,
    at_px: tuple[float, float],
    color: Color,
    *,
    size_px: int = 13,
    bold: bool = False,
    align: Align = "left",
    halo: Color | None = None,
) -> None:
    """Draw a line of text; `at_px` is half-way up its capitals, at its left, centre or right end.

    A `halo` is a rim in that colour, which keeps text legible over pictures.
    """
    sprite = _sprite(text, size_px, bold, align, color, halo)
    left = round(at_px[0] - sprite.anchor_px[0])
    top = round(at_px[1] - sprite.anchor_px[1])
    height, width = sprite.keep.shape[:2]
    rows = slice(max(0, -top), max(0, min(height, image.shape[0] - top)))
    columns = slice(max(0, -left), max(0, min(width, image.shape[1] - left)))
    patch = image[max(top, 0) : max(top + height, 0), max(left, 0) : max(left + width, 0)]
    if patch.size:
        patch[:] = (patch * sprite.keep[rows, columns] + sprite.add[rows, columns]) >> 8


def draw_arrows(
    image: RgbImage,
    starts_px: npt.ArrayLike,
    tips_px: npt.ArrayLike,
    color: Color,
    halo: Color,
    *,
    scale: float = 1.0,
) -> None:
    """Draw arrows from (N, 2) to (N, 2) with a rim in the colour `halo`; short ones have smaller heads.

    The shaft is `2 scale` px wide, the head `8 scale` px long.
    """
    starts, tips = np.asarray(starts_px, dtype=float), np.asarray(tips_px, dtype=float)
    lengths = np.linalg.norm(tips - starts, axis=1, keepdims=True)
    along = (tips - starts) / np.maximum(lengths, _POINT_PX)
    heads = np.minimum(8.0 * scale, 0.6 * lengths)
    bases, across = tips - heads * along, 0.45 * heads * along[:, ::-1] * (-1.0, 1.0)
    draw_segments(image, starts, tips, halo, round(4 * scale))
    draw_segments(image, starts, bases, color, round(2 * scale))
    for head in np.stack([tips, bases + across, bases - across], axis=1):
        fill_polygon(image, head, color)
