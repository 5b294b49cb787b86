"""Markers fitted to pixels: as well as the noise allows.

Each step is Gauss and Newton's in all a marker's unknowns (`skyherd.vision.photometric.design_matrix`), with
the squeezes of all markers as of one plane (`skyherd.vision.photometric.plane`) where that explains them, and
light even where it is. The covariance is `σ_n² (JᵀJ)⁻¹`, with the noise σ_n from what the fit leaves of the
pixels.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from skyherd.geometry import Array, BoolArray, IntArray
from skyherd.markers.dictionary import card_side, cells_per_side
from skyherd.vision.grey import Image
from skyherd.vision.photometric import design_matrix
from skyherd.vision.photometric.design_matrix import BLACK, LIGHT, MIDDLE_GREY, PIXELS, SQUEEZE, Looks
from skyherd.vision.photometric.fit_result import Fits, fits_of, print_contrasts, weighted_median
from skyherd.vision.photometric.least_squares import Solved
from skyherd.vision.photometric.local_homography import Shapes
from skyherd.vision.photometric.pattern import Pattern, blur_buckets, make_bend, make_pattern
from skyherd.vision.photometric.pixel_samples import Taken
from skyherd.vision.photometric.plane import Plane, fit_plane

INSIDE_SIGMAS, OUTSIDE_SIGMAS = 1.2, 2.5
"""Pixels are read to the latter beyond the black square, and to the former within the card's edge."""

SEEN_SIGMAS = 3.0
"""Ground nearer than this to a pixel is seen by it."""

TEXTURE = 30.0
"""Deviation of the ground's grey levels that is reckoned with, where ground blurs into the card."""

ROUNDS = 6
"""Most steps taken from where a quadrilateral puts a marker."""

FOLLOWED_ROUNDS = 12
"""From where it was expected: one that turned otherwise lies far from that, and steps are cut."""

SETTLED_PX = 0.08
"""A marker is settled once a step moves its sides by no more than this, at a noise of one grey level: as
`∫ T' T'' = 0` over an edge, a step s leaves an error in proportion to s³, and noise one to itself."""

STRAIGHT_PX = 0.002
"""Nor is it settled while the horizon last found would move a corner by more than this."""

USUAL_NOISE = 3.0
"""Standard deviation of a pixel, grey levels, until a camera's is known."""

USUAL_RATIO = 0.15
"""Black over contrast, until a fit tells."""

LARGEST_STEP = 0.15
"""Steps are cut to this, in marker sides, radians and logarithms of scale."""

LEAST_PIXELS = 2 * PIXELS
"""A marker that is seen by fewer has no say on the plane: its noise is not known."""

OFF_CELL = 0.25
"""A cell is not of the colour it should have if it leaves more than this share of the contrast."""

COVERING, COVERING_SIGMAS = 0.25, 6.0
"""A pixel that leaves more than this share of the contrast, and so many deviations of the noise, shows
something else than the marker: wrong poses and blurs leave less once a fit is near."""

PALE = 0.6
"""Less than this share of the print contrast (`fit_result`) that most pixels tell is no print."""

UNEVEN = 8.0
"""Light is taken as uneven once the markers' mean chi-squared exceeds its mean by so many deviations."""


def fit_markers(
    image: Image,
    dictionary: str,
    ids: IntArray,
    shapes: Shapes,
    sigma_px: float,
    plane: Plane,
    noise: float = USUAL_NOISE,
    rounds: int = ROUNDS,
) -> tuple[Fits, Plane]:
    """Fit markers `ids` (N,) that lie near `shapes`, a pixel or two or a tenth of a side from the truth.

    Args:
        image: grey, (height, width).
        dictionary: of the markers.
        ids: (N,), at least one.
        shapes: N of them, where to begin.
        sigma_px: blur of lens and pixel together, as far as it is known.
        plane: that the markers lie on, as far as it is known.
        noise: standard deviation of a pixel, grey levels, as far as it is known.
        rounds: most steps taken.

    Returns:
        The fits, and the plane that they say the markers lie on.
    """
    middle = complex(image.shape[1] - 1, image.shape[0] - 1) / 2
    sides_px = shapes.sides_px()
    looks = looks_of(dictionary, ids, sigma_px / sides_px, plane, noise)
    taken, n_cells = Taken(ids.size), cells_per_side(dictionary)
    start = shapes = replace(shapes, horizons=plane.horizons(shapes.centers - middle))
    rows, right = np.arange(ids.size), np.ones(ids.size, dtype=bool)
    for number in range(1, rounds + 1):
        start = shapes if rows.size == ids.size else start.put(rows, shapes.take(rows))
        taken.take(image, rows, start, looks)
        solved = taken.solved()
        if number > 1:  # before, a start that is a pixel off may leave as much as a wrong cell
            contrasts, noises = solved.contrasts()[rows], solved.noises()[rows]
            means, peaks = taken.leavings(rows, solved, n_cells)
            right[rows] = _cells_are_right(means, contrasts) & ~jut(peaks, contrasts, noises)
        heard = _heard(solved, right)
        even = solved.holding(LIGHT, np.zeros((ids.size, 2)))
        solved = solved if _is_uneven(solved, even, heard) else even
        plane, squeezes = common_plane(solved, start, middle, heard)
        solved = solved.holding(SQUEEZE, squeezes)
        looks = replace(looks, ratios=(solved.values[:, BLACK] + MIDDLE_GREY) / solved.contrasts())
        looks = replace(looks, bends=_bends(dictionary, ids, sigma_px / sides_px, plane))
        shapes, moved_px = stepped(solved, start)
        shapes = replace(shapes, horizons=plane.horizons(shapes.centers - middle))
        bent_px = np.abs(shapes.horizons - start.horizons) * sides_px**2 / 2
        unsettled = (moved_px > SETTLED_PX * np.cbrt(noise)) | (bent_px > STRAIGHT_PX)
        rows = np.flatnonzero(unsettled & (right | (number < rounds / 2)))
        if not rows.size:
            break
    leavings = taken.leavings(np.arange(ids.size), solved, n_cells)
    variances = plane.variances(shapes.centers - middle)
    return fits_of(ids, solved, shapes, leavings, moved_px, sigma_px, variances), plane


def _bends(dictionary: str, ids: IntArray, relative_sigmas: Array, plane: Plane) -> list[Pattern]:
    """What blur does to squeezed markers; nothing to look for on a plane that is not."""
    if plane == Plane():
        return []
    return _patterns(make_bend, dictionary, ids, relative_sigmas)


def _patterns(
    make: Callable[[str, int, int], Pattern], dictionary: str, ids: IntArray, relative_sigmas: Array
) -> list[Pattern]:
    buckets = blur_buckets(relative_sigmas).tolist()
    return [make(dictionary, marker, bucket) for marker, bucket in zip(ids.tolist(), buckets, strict=True)]


def looks_of(dictionary: str, ids: IntArray, relative_sigmas: Array, plane: Plane, noise: float) -> Looks:
    """What markers of `ids` (N,) look like under blurs (N,), in marker sides."""
    quiet = (card_side(dictionary) - 1) / 2
    beyond = np.clip(quiet - INSIDE_SIGMAS * relative_sigmas, 0, OUTSIDE_SIGMAS * relative_sigmas)
    return Looks(
        patterns=_patterns(make_pattern, dictionary, ids, relative_sigmas),
        bends=_bends(dictionary, ids, relative_sigmas, plane),
        sigmas=relative_sigmas,
        limits=0.5 + beyond,
        sees_ground=quiet - beyond < SEEN_SIGMAS * relative_sigmas,
        ratios=np.full(ids.size, USUAL_RATIO),
        half_card=0.5 + quiet,
        texture=TEXTURE / noise,
    )


def _cells_are_right(cell_means: Array, contrasts: Array) -> BoolArray:
    """Which of N fits leave every cell the colour it should have."""
    return np.asarray(np.abs(cell_means).max(axis=(1, 2)) < OFF_CELL * contrasts)


def jut(peaks: Array, contrasts: Array, noises: Array) -> BoolArray:
    """Which of N fits leave much more of some pixel than noise does: something may lie over the marker."""
    return np.asarray(peaks > np.maximum(COVERING * contrasts, COVERING_SIGMAS * noises))


def _heard(solved: Solved, right: BoolArray) -> BoolArray:
    """Which of N fits have a say on what all markers of an image share; all, if none is `right`.

    Not heard is what is not fitted yet, is covered in part, or may be ground that was taken for a marker:
    much of it is paler.
    """
    if not right.any():
        return np.ones_like(right)
    contrasts = solved.contrasts()
    prints = print_contrasts(solved.values[:, BLACK] + MIDDLE_GREY, contrasts)
    told = right * solved.pixels * (contrasts / solved.noises()) ** 2
    return right & (prints > PALE * weighted_median(prints, told))


def _is_uneven(solved: Solved, even: Solved, heard: BoolArray) -> bool:
    """Whether light changes over the markers, by the mean of their chi-squared of two degrees of freedom."""
    chi_squared = ((even.squares - solved.squares) / solved.noises() ** 2 / 2)[heard]
    return bool(chi_squared.mean() > 1 + UNEVEN / np.sqrt(chi_squared.size))


def common_plane(solved: Solved, shapes: Shapes, middle: complex, heard: BoolArray) -> tuple[Plane, Array]:
    """The plane, by the markers heard, and the unknowns for squeeze and shear (N, 2) that put all on it."""
    contrasts = solved.contrasts()
    found = solved.values[:, SQUEEZE] @ np.array([1, 1j]) / contrasts
    spread = solved.inverses[:, SQUEEZE, SQUEEZE].mean(axis=1)
    spread = np.where((spread > 0) & (solved.pixels > LEAST_PIXELS) & heard, spread, np.inf)
    points = shapes.centers - middle
    squeezes = (shapes.squeezes + shapes.arms * found) / shapes.arms.conj()
    plane = fit_plane(points, squeezes, spread * (solved.noises() / contrasts) ** 2)
    if plane.shared:
        found = (plane.squeezes(points) * shapes.arms.conj() - shapes.squeezes) / shapes.arms
    return plane, np.stack([found.real, found.imag], axis=1) * contrasts[:, None]


def stepped(solved: Solved, shapes: Shapes) -> tuple[Shapes, Array]:
    """The shapes moved as solved, cut to `LARGEST_STEP`, and by how much (N,) their sides' middles, px."""
    steps = solved.values / solved.contrasts()[:, None]
    shift = steps[:, design_matrix.RIGHT] + 1j * steps[:, design_matrix.DOWN]
    grow = steps[:, design_matrix.GROW] + 1j * steps[:, design_matrix.TURN]
    squeeze = steps[:, SQUEEZE] @ np.array([1, 1j])
    size = np.sqrt(np.abs(shift) ** 2 + (np.abs(grow) ** 2 + np.abs(squeeze) ** 2) / 4)
    cut = np.minimum(1.0, LARGEST_STEP / np.maximum(size, 1e-12))
    return shapes.moved(cut * shift, cut * grow, cut * squeeze), size * shapes.sides_px()
