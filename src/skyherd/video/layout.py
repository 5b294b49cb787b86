"""Positions of all parts of a video frame: side by side on a wide frame, one below the other for phones."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from skyherd.drawing.canvas import Box
from skyherd.video.camera_panel import BORDER_PX, TITLE_PX
from skyherd.video.legend import ITEMS, Item, legend_height_px

SIZE_PX = (1600, 1000)
"""Size of the wide frame."""

PHONE_PX = 520
"""Width of the frame for phones, px. Chosen: at 390 px, text of 12 px is 9 px high."""

HEADER_PX, CAPTION_PX = 42, 30
"""Heights of the line with name and figures, and of the caption below it, px."""

PHONE_HEADER_PX, PHONE_CAPTION_PX, PHONE_GROUND_PX, PHONE_PLOT_PX = 56, 76, 440, 170
"""Heights in the frame for phones, px: two lines of figures, the caption, the ground, and a plot."""

PLOTS_SHARE = 0.25
"""Height of the curves at the bottom, as a share of the frame's."""

CAMERAS_SHARE = 0.62
"""Maximum width of the camera block, as a share of the frame's; the ground has the rest."""

STRIPS_PX = (0, *range(24, 320, 24))
"""Candidate heights of a strip with the legend below the cameras, px; 0 means no strip."""

GAP_PX = 14
"""Distance between panels."""

MUCH_LARGER = 1.2
"""Minimum enlargement of cameras that justifies more columns. A wide block leaves less width to the ground
and more of the frame empty."""

MIN_PAIR_PX = 110
"""Minimum width of a camera image with its rectified image below, px. Chosen: robots are visible."""

MANY_UNITS = 8
"""Number of units above which a frame for phones has more than two columns, and no rectified images."""


@dataclass(frozen=True)
class Layout:
    """Positions of all parts on the canvas.

    Attributes:
        size_px: width and height of the canvas.
        header: name, time and figures.
        caption: the description, and at the end the verdict.
        cameras: a cell for each camera image.
        rectified: a cell for each rectified image; empty if these are not shown.
        key: the legend.
        ground: the ground from above.
        plots: the curves of V, and of the scales.
    """

    size_px: tuple[int, int]
    header: Box
    caption: Box
    cameras: list[Box]
    rectified: list[Box]
    key: Box
    ground: Box
    plots: tuple[Box, Box]


def make_layout(
    size_px: tuple[int, int],
    image_sizes_px: Sequence[tuple[int, int]],
    items: Sequence[Item] = ITEMS,
    *,
    rectified: bool = False,
) -> Layout:
    """Lay out a wide frame: cameras in a near-square block on the left, the ground beside it, curves below.

    A rectified image is below its camera's. The legend is placed in the free space of the block's last row,
    or else below the block. Among all fitting blocks, the one with the largest images is chosen.

    Args:
        size_px: width and height of the frame.
        image_sizes_px: width and height of each camera's images.
        items: symbols of the legend.
        rectified: show the rectified images as well, if they are at least `MIN_PAIR_PX` wide.
    """
    width, height = size_px
    units, square = len(image_sizes_px), int(np.ceil(np.sqrt(len(image_sizes_px))))
    stack = 2 if rectified else 1
    choices = range(1, units + 1) if rectified else range(square, square + 3)
    bottom = height - round(PLOTS_SHARE * height)
    blocks = [
        _block(columns, (width, bottom), image_sizes_px, strip_px, items, stack)
        for columns in choices
        for strip_px in STRIPS_PX
    ]
    pitch_u, pitch_v, columns, key = max(
        (block for block in blocks if block),
        key=lambda block: block[0] if rectified or block[2] == square else block[0] / MUCH_LARGER,
        default=(0, 0, 0, Box(left=0, top=0, width=0, height=0)),
    )
    if rectified and pitch_u < MIN_PAIR_PX:
        return make_layout(size_px, image_sizes_px, items)
    top = HEADER_PX + CAPTION_PX
    corners = [
        (GAP_PX + k % columns * pitch_u, top + (k // columns * stack + row) * pitch_v)
        for row in range(stack)
        for k in range(units)
    ]
    cells = [Box(left=u, top=v, width=pitch_u - GAP_PX, height=pitch_v - GAP_PX) for u, v in corners]
    left = 2 * GAP_PX + columns * pitch_u
    half = (width - 3 * GAP_PX) // 2
    plots = tuple(
        Box(left=u, top=bottom + 4, width=half, height=height - bottom - 4)
        for u in (GAP_PX, width - GAP_PX - half)
    )
    return Layout(
        size_px=size_px,
        header=Box(left=GAP_PX, top=0, width=width - 2 * GAP_PX, height=HEADER_PX),
        caption=Box(left=GAP_PX, top=HEADER_PX, width=width - 2 * GAP_PX, height=CAPTION_PX - 4),
        cameras=cells[:units],
        rectified=cells[units:],
        key=key,
        ground=Box(left=left, top=top, width=width - left - GAP_PX, height=bottom - top),
        plots=(plots[0], plots[1]),
    )


def _block(
    columns: int,
    room_px: tuple[int, int],
    image_sizes_px: Sequence[tuple[int, int]],
    strip_px: int,
    items: Sequence[Item],
    stack: int,
) -> tuple[int, int, int, Box] | None:
    """Return cell pitches, px, columns, and a box for the key; None if the key does not fit.

    The key is in a strip below the cells, or beside the last row's if that strip is 0 px high.
    """
    width, bottom = room_px
    units, top = len(image_sizes_px), HEADER_PX + CAPTION_PX
    rows = -(-units // columns)
    aspect = max(w / h for w, h in image_sizes_px)
    frame = 2 * BORDER_PX
    high = (bottom - top - strip_px) / (rows * stack) - TITLE_PX - frame - GAP_PX
    wide = min(high * aspect, CAMERAS_SHARE * width / columns - frame - GAP_PX)
    pitch_u, pitch_v = int(wide) + frame + GAP_PX, int(wide / aspect) + TITLE_PX + frame + GAP_PX
    below = top + rows * stack * pitch_v
    if strip_px:
        key = Box(
            left=GAP_PX, top=below - GAP_PX // 2, width=columns * pitch_u - GAP_PX, height=bottom - below
        )
    else:
        filled = units - (rows - 1) * columns
        left = GAP_PX + filled * pitch_u
        key = Box(
            left=left,
            top=below - stack * pitch_v,
            width=(columns - filled) * pitch_u - GAP_PX,
            height=stack * pitch_v - GAP_PX,
        )
    fits = wide > 0 and key.width > 0 and legend_height_px(key.width, items) <= key.height
    return (pitch_u, pitch_v, columns, key) if fits else None


def make_phone_layout(
    image_sizes_px: Sequence[tuple[int, int]], items: Sequence[Item] = ITEMS, *, rectified: bool = False
) -> Layout:
    """Lay out a narrow frame, as high as its parts: ground, cameras, curves and legend one below the other.

    Cameras have two columns; with rectified images, each camera has a row with its own beside it.

    Args:
        image_sizes_px: width and height of each camera's images.
        items: symbols of the legend.
        rectified: show the rectified images as well, of up to `MANY_UNITS` units.
    """
    units, gap, room = len(image_sizes_px), GAP_PX // 2, PHONE_PX - GAP_PX
    rectified = rectified and units <= MANY_UNITS
    columns = 2 if units <= MANY_UNITS else int(np.ceil(np.sqrt(units)))
    columns = 1 if units == 1 and not rectified else columns
    wide = (room + gap) // columns - gap
    aspect = max(w / h for w, h in image_sizes_px)
    high = int((wide - 2 * BORDER_PX) / aspect) + TITLE_PX + 2 * BORDER_PX
    top = PHONE_HEADER_PX + PHONE_CAPTION_PX
    ground = Box(left=gap, top=top, width=room, height=PHONE_GROUND_PX)
    top += PHONE_GROUND_PX + gap
    places = range(units * (2 if rectified else 1))
    cells = [
        Box(
            left=gap + k % columns * (wide + gap),
            top=top + k // columns * (high + gap),
            width=wide,
            height=high,
        )
        for k in places
    ]
    top += -(-len(places) // columns) * (high + gap)
    plots = [
        Box(left=gap, top=top + k * PHONE_PLOT_PX, width=room, height=PHONE_PLOT_PX - gap) for k in range(2)
    ]
    top += 2 * PHONE_PLOT_PX
    key = Box(left=gap, top=top, width=room, height=legend_height_px(room, items))
    height = top + key.height + gap
    return Layout(
        size_px=(PHONE_PX, height + height % 2),
        header=Box(left=gap, top=0, width=room, height=PHONE_HEADER_PX),
        caption=Box(left=gap, top=PHONE_HEADER_PX, width=room, height=PHONE_CAPTION_PX - gap),
        cameras=cells[::2] if rectified else cells,
        rectified=cells[1::2] if rectified else [],
        key=key,
        ground=ground,
        plots=(plots[0], plots[1]),
    )
