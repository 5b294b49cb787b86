"""All markers of a dictionary in every way in which an image may show them, to compare cells with."""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import numpy.typing as npt

from skyherd.geometry import BoolArray, IntArray
from skyherd.markers.dictionary import all_marker_cells
from skyherd.vision.blurred_cells import blurred_darkness

FIRST_BLUR_CELLS = 0.3
"""Standard deviation of the blur, in cells, at the first look. Chosen: moderate, so that the nearest markers
are among the `FINALISTS` at any other."""


@dataclass(frozen=True)
class Templates:
    """All N markers of a dictionary in four quarter turns, as they are and mirrored: 8 N templates.

    The row of marker i in turn k is `4 N mirrored + N k + i`. A mirror image that is a marker as well, of the
    same id or of another, counts as that marker.

    Attributes:
        white: (8 N, n, n) which cells are white.
        levels: (8 N, n, n) levels of the cells' middles under `FIRST_BLUR_CELLS`, 0 black, 1 white.
        count: number N of markers.
        unmirrored: (8 N,) for each row the row of the same cells that is not mirrored, or itself if the
            mirror image is no marker.
    """

    white: BoolArray
    levels: npt.NDArray[np.float32]
    count: int
    unmirrored: IntArray

    def row(self, index: int) -> tuple[int, bool]:
        """Return the marker id of a row, and whether it is the mirror image of a marker and none itself."""
        own = int(self.unmirrored[index])
        return own % self.count, own >= 4 * self.count

    def wrong_cells(self, index: int, white: BoolArray, seen: BoolArray) -> tuple[tuple[int, int], ...]:
        """Return row and column, from 1, of the cells (n, n) that are seen and are not those of a row.

        They are counted in the marker, from its corner that is ahead on the left.
        """
        own = int(self.unmirrored[index])
        turned = np.rot90((white != self.white[own]) & seen, -(own % (4 * self.count) // self.count))
        return tuple((int(row) + 1, int(column) + 1) for row, column in np.argwhere(turned))


def blurred_levels(white: BoolArray, blur_cells: float, per_cell: int) -> npt.NDArray[np.float32]:
    """Return levels (M, S, S), S = n per_cell, of markers (M, n, n) on a white ground under a blur."""
    return (1.0 - blurred_darkness(white, blur_cells, per_cell)).astype(np.float32)


@lru_cache(maxsize=4)
def load_templates(dictionary: str) -> Templates:
    """Return the templates of a dictionary; the last four dictionaries are kept."""
    cells = all_marker_cells(dictionary)
    count = len(cells)
    sides = (cells, cells[:, :, ::-1])
    white = np.concatenate([np.rot90(side, turn, (1, 2)) for side in sides for turn in range(4)])
    levels = blurred_levels(white, FIRST_BLUR_CELLS, 1)
    rows = {cell.tobytes(): row for row, cell in reversed(list(enumerate(white[: 4 * count])))}
    unmirrored = np.array([rows.get(cell.tobytes(), row) for row, cell in enumerate(white)])
    return Templates(white, levels, count, unmirrored)
