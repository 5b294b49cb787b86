"""What lies around markers: a white card, or ground from the black border on.

The model takes the ground around a marker for white, as its card is. A marker that was cut out along its
border has an outline of another contrast: of 1 + ρ times that of its cells, with the ground's level ρ, that
is less white and over the contrast. With G what a blurred black frame from the border outwards looks like, a
pixel has `a + b T + g G`, `g = b ρ`, and a step of the pose changes it by `b (T_z + ρ G_z) · δz`. The ground
is an unknown of each step (`design_matrix`), and its slopes are those of the level that the last step found.

The ground's texture is measured, too: beside the marker, pixels vary by `σ² + (t G)²`. They are weighted
accordingly, so that even ground tells the outline and rough ground does not pull at it.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from skyherd.geometry import Array, BoolArray
from skyherd.vision.native.records import SURROUNDINGS
from skyherd.vision.row_record import RowRecord

START_TEXTURE = 30.0
"""Texture assumed before the first step, grey levels. Chosen: pixels beyond the border then count little, so
that the cells decide on the first step of the pose."""


@dataclass(frozen=True)
class Surroundings(RowRecord):
    """Ground around N markers.

    Attributes:
        levels: (N,) ground less white, over the contrast; NaN for a marker on a white card.
        textures: (N,) standard deviations of the ground about its level, grey levels.
    """

    levels: Array
    textures: Array

    @classmethod
    def of_cards(cls, count: int) -> "Surroundings":
        """Return the surroundings of markers on white cards."""
        return cls(np.full(count, np.nan), np.zeros(count))

    @classmethod
    def of_ground(cls, levels: Array) -> "Surroundings":
        """Return the surroundings of markers without cards, on ground of levels (N,) and unknown texture."""
        return cls(levels, np.full(levels.size, START_TEXTURE))

    @classmethod
    def of_records(cls, records: npt.NDArray[np.void]) -> "Surroundings":
        """Return the surroundings of records (N,) of `SURROUNDINGS`."""
        return cls(*(np.ascontiguousarray(records[name]) for name in SURROUNDINGS.names or ()))

    def records(self) -> npt.NDArray[np.void]:
        """Return the surroundings as records (N,) of `SURROUNDINGS`."""
        records = np.empty(self.levels.size, dtype=SURROUNDINGS)
        records["levels"], records["textures"] = self.levels, self.textures
        return records

    def is_bare(self) -> BoolArray:
        """Return which markers (N,) have no card."""
        return ~np.isnan(self.levels)
