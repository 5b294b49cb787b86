"""How markers look at their size and blur: their cells, and what of the ground around them is seen.

A card is narrow, and blur lets the ground beyond it into the marker's pixels. Whether any of it is seen is
decided here; its level is an unknown of the fit, and its texture counts as noise
(`design_matrix`).
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import numpy.typing as npt

from skyherd.geometry import Array, BoolArray, IntArray
from skyherd.markers.dictionary import card_side, cells_per_side, marker_cells
from skyherd.vision.native.records import APPEARANCE, AppearanceConstants
from skyherd.vision.photometric.fitting.plane import Plane
from skyherd.vision.photometric.fitting.surroundings import Surroundings

OUTSIDE_SIGMAS = 2.5
"""Pixels are read up to this many standard deviations of the blur beyond the black square, where the edge is
told by them. Chosen: further out the edge adds less than 1 % of the contrast."""

INSIDE_SIGMAS = 1.2
"""Pixels are read no nearer to the card's own edge than this, standard deviations of the blur: what lies
beyond it is unknown ground. Chosen: smaller lets more ground in, larger loses pixels of the black square's
edge on small markers."""

GROUND_SIGMAS = 3.0
"""The ground is an unknown for markers of which a pixel lies nearer to the card's edge than this, standard
deviations of the blur. Chosen: beyond it a pixel holds 0.1 % of ground."""

TEXTURE = 30.0
"""Assumed standard deviation of the ground's texture, grey levels. Chosen: larger values weigh down the
pixels near the card's edge more, smaller ones make the covariance too small over rough ground."""

USUAL_BLACK_RATIO = 0.15
"""Assumed black level over contrast, before the first step. Chosen: that of a black of 30 beside a white of
230; the first step replaces it."""


@dataclass(frozen=True)
class MarkerAppearances:
    """Appearance of N markers at their size and blur; lengths are in marker sides.

    Attributes:
        cells: (N, n + 2, n + 2) 1 where a cell is black, 0 where it is white and on the ground around.
        sigmas: (N,) standard deviations of the blur.
        read_limits: (N,) marker coordinates up to which pixels are read.
        reaches_ground: (N,) whether the blur brings ground beyond the card into those pixels.
        black_ratios: (N,) black level over contrast, the r of the model.
        surroundings: of the markers.
        half_card: distance of the card's edge from the marker's centre.
        texture: standard deviation of the ground's texture over that of the noise.
        round_in_image: whether the blur is drawn round in the image, and not in the marker's coordinates; the
            two are the same on a plane that is seen from straight above.
        streak_px2: by how much the blur differs along the image's axes, the Q of `design_matrix`, px². Any
            number makes all blurs ellipses, zero too; None makes those that a steep tilt makes.
    """

    cells: npt.NDArray[np.float32]
    sigmas: Array
    read_limits: Array
    reaches_ground: BoolArray
    black_ratios: Array
    surroundings: Surroundings
    half_card: float
    texture: float
    round_in_image: bool
    streak_px2: complex | None = None

    def records(self) -> npt.NDArray[np.void]:
        """Return the appearances as records (N,) of `APPEARANCE`."""
        records = np.empty(self.sigmas.size, dtype=APPEARANCE)
        records["sigma"], records["limit"] = self.sigmas, self.read_limits
        records["half_card"] = np.where(self.reaches_ground, self.half_card, np.inf)
        records["black_ratio"] = self.black_ratios
        records["surroundings"] = self.surroundings.records()
        return records


def appearances_of(
    dictionary: str,
    ids: IntArray,
    relative_sigmas: Array,
    plane: Plane,
    noise: float,
    streak_px2: complex | None = None,
    surroundings: Surroundings | None = None,
) -> MarkerAppearances:
    """Return how markers `ids` (N,) look under blurs (N,), standard deviations in marker sides.

    `noise`, the standard deviation of a pixel in grey levels, sets how strongly the ground's texture counts.
    The blur has a streak if `streak_px2` is given; see the attribute. Markers are on white cards unless their
    `surroundings` are given.

    Raises:
        InputError: there is no such dictionary, or no marker of such an id in it.
    """
    quiet = quiet_zone(dictionary)
    beyond = np.clip(quiet - INSIDE_SIGMAS * relative_sigmas, 0, OUTSIDE_SIGMAS * relative_sigmas)
    reaches_ground = quiet - beyond < GROUND_SIGMAS * relative_sigmas
    if surroundings is None:
        surroundings = Surroundings.of_cards(ids.size)
    else:  # the ground around a marker without a card is in its model
        beyond = np.where(surroundings.is_bare(), OUTSIDE_SIGMAS * relative_sigmas, beyond)
        reaches_ground &= ~surroundings.is_bare()
    return MarkerAppearances(
        cells=black_cells(dictionary, ids),
        sigmas=relative_sigmas,
        read_limits=0.5 + beyond,
        reaches_ground=reaches_ground,
        black_ratios=np.full(ids.size, USUAL_BLACK_RATIO),
        surroundings=surroundings,
        half_card=0.5 + quiet,
        texture=TEXTURE / noise,
        round_in_image=plane != Plane() or streak_px2 is not None,
        streak_px2=streak_px2,
    )


@lru_cache(maxsize=16)
def appearance_constants(dictionary: str) -> AppearanceConstants:
    """Return the constants of the appearances of a dictionary's markers for the compiled library."""
    return AppearanceConstants(
        quiet=quiet_zone(dictionary),
        outside_sigmas=OUTSIDE_SIGMAS,
        inside_sigmas=INSIDE_SIGMAS,
        ground_sigmas=GROUND_SIGMAS,
        texture=TEXTURE,
        black_ratio=USUAL_BLACK_RATIO,
    )


def black_cells(dictionary: str, ids: IntArray) -> npt.NDArray[np.float32]:
    """Return the cells (N, n + 2, n + 2) of markers, read-only: 1 where black, 0 elsewhere and around.

    Raises:
        InputError: there is no such dictionary, or no marker of such an id in it.
    """
    return _black_cells(dictionary, tuple(ids.tolist()))


@lru_cache(maxsize=64)
def _black_cells(dictionary: str, ids: tuple[int, ...]) -> npt.NDArray[np.float32]:
    """Return the result of `black_cells`. The cache holds 64, since a camera sees the same markers again."""
    n = cells_per_side(dictionary)
    cells = np.zeros((len(ids), n + 2, n + 2), dtype=np.float32)
    for own, marker in zip(cells, ids, strict=True):
        own[1:-1, 1:-1] = ~marker_cells(dictionary, marker)
    cells.setflags(write=False)
    return cells


def quiet_zone(dictionary: str) -> float:
    """Return the width of the white card beyond the marker, in marker sides."""
    return (card_side(dictionary) - 1) / 2
