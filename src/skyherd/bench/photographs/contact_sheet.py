"""Contact sheets: places of many images side by side, cropped, enlarged and labelled."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt
from PIL import Image

from skyherd.bench.photographs.confirmation import Place, family
from skyherd.drawing.canvas import draw_lines, draw_text
from skyherd.drawing.palette import INK, PAPER, UNIT_COLORS, rgb
from skyherd.files.atomic import write_whole

TILE_PX = 128
"""Side of a tile, px. Chosen: resolves the cells of a marker of 6x6 bits."""

SHOWN_SIDES = 2.4
"""Side of a tile's content, in marker sides. Chosen: the marker fills a sixth of it, so that its
surroundings are visible."""

COLUMNS, MAX_TILES = 8, 64
"""Tiles in a row, and on a sheet. Chosen: a sheet has a screen's height; of more tiles, a regular subset is
shown."""

TEXT_PX, LINE_PX = 11, 14
"""Height of letters and of a line of text below a tile, px. Chosen: about the smallest legible size."""

LETTERS = 18
"""Maximum letters of a line below a tile; longer names lose their beginning. Chosen: capitals, the widest
letters, fit its width."""


@dataclass(frozen=True)
class PlaceTile:
    """A place cropped from its image.

    Attributes:
        picture: RGB (TILE_PX, TILE_PX, 3), with the place outlined.
        lines: texts below it.
    """

    picture: npt.NDArray[np.uint8]
    lines: tuple[str, ...]


def cut_tile(image: npt.NDArray[np.uint8], place: Place, file: str) -> PlaceTile:
    """Crop a place from a grey image, with its id and side below it; grey beyond the image."""
    reach = int(np.ceil(SHOWN_SIDES * place.side_px / 2)) + 1
    middle = np.rint(place.center_px).astype(int)
    cut = np.full((2 * reach + 1, 2 * reach + 1), 128, dtype=np.uint8)
    low, high = np.maximum(middle - reach, 0), np.minimum(middle + reach + 1, image.shape[::-1])
    at, end = low - (middle - reach), high - (middle - reach)
    cut[at[1] : end[1], at[0] : end[0]] = image[low[1] : high[1], low[0] : high[0]]
    scale = TILE_PX / len(cut)
    method = cv2.INTER_AREA if scale < 1 else cv2.INTER_NEAREST
    cut = np.asarray(cv2.resize(cut, (TILE_PX, TILE_PX), interpolation=method), dtype=np.uint8)
    picture = np.asarray(cv2.cvtColor(cut, cv2.COLOR_GRAY2RGB), dtype=np.uint8)
    corners = (place.corners_px - middle + reach + 0.5) * scale - 0.5
    draw_lines(picture, [corners], rgb(UNIT_COLORS[1]), 1, closed=True)
    found = ", ".join(dict.fromkeys(family(name) for name in place.found_by))
    return PlaceTile(picture, (f"id {place.marker_id}, {place.side_px:.0f} px", file, found))


def draw_sheet(tiles: Sequence[PlaceTile]) -> npt.NDArray[np.uint8]:
    """Arrange at most `MAX_TILES` tiles in rows, and return the sheet (height, width, 3) in RGB."""
    chosen = [tiles[k] for k in np.linspace(0, len(tiles) - 1, min(len(tiles), MAX_TILES)).astype(int)]
    lines = max(len(tile.lines) for tile in chosen)
    height, width = TILE_PX + LINE_PX * lines + 6, TILE_PX + 6
    rows = -(-len(chosen) // COLUMNS)
    sheet = np.full((rows * height, min(len(chosen), COLUMNS) * width, 3), rgb(PAPER), dtype=np.uint8)
    for index, tile in enumerate(chosen):
        top, left = height * (index // COLUMNS), width * (index % COLUMNS)
        sheet[top : top + TILE_PX, left : left + TILE_PX] = tile.picture
        for number, line in enumerate(tile.lines):
            at = (left, top + TILE_PX + LINE_PX * number + LINE_PX // 2)
            text = line if len(line) <= LETTERS else f"…{line[1 - LETTERS :]}"
            draw_text(sheet, text, at, rgb(INK), size_px=TEXT_PX)
    return sheet


def write_sheet(tiles: Sequence[PlaceTile], path: Path) -> Path:
    """Write a contact sheet as PNG, and return its path.

    Raises:
        OutputError: it could not be written.
    """
    sheet = Image.fromarray(draw_sheet(tiles))
    return write_whole(path, lambda part: sheet.save(part, format="PNG"))
