"""How markers look at their size and blur: their patterns, and what of the ground around them is seen.

A card is narrow, and blur lets the ground beyond it into the marker's pixels. How much of it each pixel sees
is computed here; its level is an unknown of the fit, and its texture counts as noise
(`skyherd.vision.photometric.design_matrix`).
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.special import ndtr

from skyherd.geometry import Array, BoolArray, ComplexArray, IntArray
from skyherd.markers.dictionary import card_side
from skyherd.vision.photometric.pattern import Pattern, blur_buckets, make_anisotropy, make_pattern
from skyherd.vision.photometric.pixel_support import Floats
from skyherd.vision.photometric.plane import Plane

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

EDGE_REACH = 4.0
"""Half-width of the tabulated card edge, in standard deviations of the blur; beyond it the edge is 0 or 1.
Chosen: the normal distribution is within 3e-5 of its limits there."""

EDGE_SAMPLES_PER_SIGMA = 64
"""Entries of the table of the card's edge to one standard deviation. Derived accuracy of the nearest entry:
`φ(0) / (2 · 64)` = 0.003 of the step from card to ground."""

_EDGE: Floats = ndtr(
    np.arange(-EDGE_REACH, EDGE_REACH + 1 / EDGE_SAMPLES_PER_SIGMA, 1 / EDGE_SAMPLES_PER_SIGMA)
).astype(np.float32)
_EDGE[[0, -1]] = 0.0, 1.0


@dataclass(frozen=True)
class MarkerAppearances:
    """What N markers look like at their size and blur; lengths are in marker sides.

    Attributes:
        patterns: N patterns, for the marker's bits under its blur.
        anisotropies: N patterns of `make_anisotropy`, or none at all if no marker is squeezed.
        sigmas: (N,) standard deviations of the blur.
        read_limits: (N,) marker coordinates up to which pixels are read.
        reaches_ground: (N,) whether the blur brings ground beyond the card into those pixels.
        black_ratios: (N,) black level over contrast, the r of the model.
        half_card: distance of the card's edge from the marker's centre.
        texture: standard deviation of the ground's texture over that of the noise.
    """

    patterns: list[Pattern]
    anisotropies: list[Pattern]
    sigmas: Array
    read_limits: Array
    reaches_ground: BoolArray
    black_ratios: Array
    half_card: float
    texture: float

    def take(self, rows: IntArray) -> "MarkerAppearances":
        """Return the appearances of the markers at indices `rows` (K,)."""
        return MarkerAppearances(
            patterns=[self.patterns[row] for row in rows],
            anisotropies=[self.anisotropies[row] for row in rows] if self.anisotropies else [],
            sigmas=self.sigmas[rows],
            read_limits=self.read_limits[rows],
            reaches_ground=self.reaches_ground[rows],
            black_ratios=self.black_ratios[rows],
            half_card=self.half_card,
            texture=self.texture,
        )


def appearances_of(
    dictionary: str, ids: IntArray, relative_sigmas: Array, plane: Plane, noise: float
) -> MarkerAppearances:
    """Return how markers `ids` (N,) look under blurs (N,), standard deviations in marker sides.

    `noise`, the standard deviation of a pixel in grey levels, sets how strongly the ground's texture counts.
    """
    quiet = (card_side(dictionary) - 1) / 2
    beyond = np.clip(quiet - INSIDE_SIGMAS * relative_sigmas, 0, OUTSIDE_SIGMAS * relative_sigmas)
    return MarkerAppearances(
        patterns=_patterns(make_pattern, dictionary, ids, relative_sigmas),
        anisotropies=anisotropies_of(dictionary, ids, relative_sigmas, plane),
        sigmas=relative_sigmas,
        read_limits=0.5 + beyond,
        reaches_ground=quiet - beyond < GROUND_SIGMAS * relative_sigmas,
        black_ratios=np.full(ids.size, USUAL_BLACK_RATIO),
        half_card=0.5 + quiet,
        texture=TEXTURE / noise,
    )


def anisotropies_of(dictionary: str, ids: IntArray, relative_sigmas: Array, plane: Plane) -> list[Pattern]:
    """Return what round blur does to squeezed markers `ids` (N,) under blurs (N,), in marker sides.

    The list is empty on a plane that is seen from straight above, where nothing is squeezed.
    """
    if plane == Plane():
        return []
    return _patterns(make_anisotropy, dictionary, ids, relative_sigmas)


def _patterns(
    make: Callable[[str, int, int], Pattern], dictionary: str, ids: IntArray, relative_sigmas: Array
) -> list[Pattern]:
    buckets = blur_buckets(relative_sigmas).tolist()
    return [make(dictionary, marker, bucket) for marker, bucket in zip(ids.tolist(), buckets, strict=True)]


def ground_share(x: Floats, y: Floats, appearances: MarkerAppearances, squeezes: ComplexArray) -> Floats:
    """Return the share (N, M) of ground beyond the card that is seen at marker coordinates x, y (N, M).

    It is `1 - A(x) A(y)`. With the blur σ and the card's edge at h, `A(x) = Φ((h - |x|) / σ)`; the opposite
    edge is too far away to count. The share is zero for a marker whose pixels reach no ground.

    In the coordinates of a marker that is squeezed by e = `squeezes` (N,), `z + e z̄`, blur that is round in
    the image has standard deviations `σ |1 ∓ e| / sqrt(1 + |e|²)` along x and y, where σ is that of their
    mean variance (`LocalHomographies.blurs`).
    """
    middle = EDGE_REACH * EDGE_SAMPLES_PER_SIGMA + 0.5

    def covered(along: Floats, stretch: Array) -> Floats:
        per_side = EDGE_SAMPLES_PER_SIGMA / (appearances.sigmas * stretch)
        edge = np.where(appearances.reaches_ground, appearances.half_card * per_side + middle, np.inf)
        place = edge.astype(np.float32)[:, None] - per_side.astype(np.float32)[:, None] * np.abs(along)
        return _EDGE.take(np.clip(place, 0, 2 * middle - 1, out=place).astype(np.intp), mode="wrap")

    x_stretch, y_stretch = (
        np.abs(1 + sign * squeezes) / np.sqrt(1 + np.abs(squeezes) ** 2) for sign in (-1, 1)
    )
    return np.asarray(1 - covered(x, x_stretch) * covered(y, y_stretch))
