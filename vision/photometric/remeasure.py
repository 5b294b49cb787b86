"""Detected markers measured again, each by itself: corners with covariances for poses, and light and blur.

`Detections` have covariances of centre and heading, and their corners use what the markers of an image share.
A pose in space follows from all eight numbers of a marker's homography. `measure_outlines` fits every marker
once more with all of them free: no common plane, and no expected keystone. The corners are then unbiased
whatever plane the marker lies on, and their errors are independent from marker to marker.

`measure_marker_images` gives light and blur, for the set-up of a camera.
"""

from dataclasses import dataclass, replace

import numpy as np

from skyherd.geometry import SQUARE_CORNERS, Array, BoolArray, ComplexArray, to_points
from skyherd.markers.dictionary import cells_per_side, with_border
from skyherd.messages import Detections, Quality
from skyherd.vision.grey import Image, check_grey
from skyherd.vision.native.library import library
from skyherd.vision.photometric.cards import refit_each_without_card
from skyherd.vision.photometric.fitting.appearance import appearances_of
from skyherd.vision.photometric.fitting.common_unknowns import OWN_PLANES
from skyherd.vision.photometric.fitting.correlated_noise import PooledRatios
from skyherd.vision.photometric.fitting.design_matrix import (
    ANISOTROPY,
    DOWN,
    GROW,
    KEYSTONE,
    POSE,
    RIGHT,
    TURN,
)
from skyherd.vision.photometric.fitting.fit import MIN_CONTRAST, fit_request, has_outlier_pixels
from skyherd.vision.photometric.fitting.fit_result import FitResults
from skyherd.vision.photometric.fitting.local_homography import LocalHomographies
from skyherd.vision.photometric.image_noise import image_noise
from skyherd.vision.photometric.refine import (
    MAX_SIDE_PX,
    START_SIGMA_PX,
    ScaledImage,
    fit_any_blur,
    size_octaves,
    with_usual_blur,
)

MAX_STEPS, SETTLED_PX = 8, 1e-3
"""Most steps of the fit with all eight numbers free, and the step that ends it, px. Chosen: a tenth of the
standard deviation of a corner; a step leaves an error of third order."""

MAX_MOVE_SIDES = 0.25
"""A corner that a fit moves by more is not the detection's, marker sides. Chosen: two cells of 4X4_50."""

ASSUMED_STD_PX = 0.25
"""Standard deviation of a corner along each axis, px, where the detector states no covariance. Chosen: that
of OpenCV's corners of markers of 30 px."""


def measure_outlines(
    image: Image,
    found: Detections,
    dictionary: str,
    *,
    border_bits: int = 1,
    inverted: bool = False,
) -> tuple[Array, Array]:
    """Return the corners (N, 4, 2), px, of detected markers, and their covariances (N, 8, 8), px².

    Markers of the quality `PHOTOMETRIC` are fitted to the image again. Those of a lesser quality, and those
    that may be covered, keep the corners of the detection, with equal and independent errors.

    Args:
        image: grey, (height, width), in which the markers were found.
        found: the markers.
        dictionary: name of the markers' dictionary.
        border_bits: width of the markers' black border in cells.
        inverted: True for white markers on black.

    Raises:
        InputError: the image is not a grey one of 8 bits, or there is no such dictionary.
    """
    image = check_grey(image)
    image = np.asarray(255 - image, dtype=np.uint8) if inverted else image
    corners_px, covariances = found.corners_px.copy(), _independent_errors(found)
    rows = np.flatnonzero(found.qualities == Quality.PHOTOMETRIC)
    if not rows.size:
        return corners_px, covariances
    name, noise = with_border(dictionary, border_bits), image_noise(image)
    start = LocalHomographies.of_quads(found.corners_px[rows])
    fits, _ = fit_any_blur(image, name, found.ids[rows], start, START_SIGMA_PX, OWN_PLANES, noise, alone=True)
    fits = refit_each_without_card(image, name, fits, start, noise)
    sigmas_px, octaves = with_usual_blur(fits), size_octaves(fits.homographies, MAX_SIDE_PX)
    for octave in np.unique(octaves):
        here, scaled = np.flatnonzero(octaves == octave), ScaledImage(image, 2 ** int(octave))
        shrunk = replace(fits.take(here), homographies=fits.homographies.take(here).scaled(scaled.shrink))
        there, errors, explained = _fit_freely(
            scaled.image, name, shrunk, scaled.sigmas_px(sigmas_px[here]), scaled.noise(noise)
        )
        free_px = to_points(there.scaled(1 / scaled.shrink).images(SQUARE_CORNERS))
        moved_px = np.linalg.norm(free_px - found.corners_px[rows[here]], axis=2).max(axis=1)
        kept = np.flatnonzero(
            explained
            & (moved_px < MAX_MOVE_SIDES * found.sides_px[rows[here]])
            & np.isfinite(errors).all(axis=(1, 2))
        )
        corners_px[rows[here[kept]]] = free_px[kept]
        covariances[rows[here[kept]]] = scaled.shrink**2 * errors[kept]
    return corners_px, covariances


def _fit_freely(
    image: Image, dictionary: str, fits: FitResults, sigmas_px: Array, noise: float
) -> tuple[LocalHomographies, Array, BoolArray]:
    """Return homographies of N markers, all eight numbers free, covariances (N, 8, 8) of their corners, px².

    Also returned is which markers (N,) leave no pixel far off: the others may be covered.

    Args:
        image: grey, (height, width).
        dictionary: of the markers.
        fits: where to begin.
        sigmas_px: (N,) standard deviations of the blur of lens and pixel together.
        noise: standard deviation of a pixel, grey levels.
    """
    blurs = fits.homographies.blurs(sigmas_px)
    around = fits.surroundings
    appearances = appearances_of(dictionary, fits.ids, blurs, OWN_PLANES, noise, surroundings=around)
    appearances = replace(appearances, black_ratios=fits.blacks / np.maximum(fits.contrasts, MIN_CONTRAST))
    request = fit_request(image, fits.homographies, appearances, noise, MAX_STEPS)
    records, by_pose = library().fit_freely(request, SETTLED_PX)
    homographies = LocalHomographies.of_records(records["homography"])
    factors = PooledRatios().updated(records["variance_ratios"], records["boxes"]).factors()
    contrasts = np.maximum(records["contrasts"], MIN_CONTRAST)
    explained = ~has_outlier_pixels(records["peaks"], contrasts, records["noise_stds"])
    return homographies, _corner_covariances(by_pose, homographies, factors), explained


def _corner_covariances(by_pose: Array, homographies: LocalHomographies, factors: Array) -> Array:
    """Return the covariances (N, 8, 8) of the corners, px², from those of the pose's eight unknowns.

    Correlated noise multiplies the variance of the corners' mean by the factor of positions, and that of the
    rest by the factor of headings (`correlated_noise`).
    """
    mean = np.kron(np.full((4, 4), 0.25), np.eye(2))
    spread = np.sqrt(factors[0]) * mean + np.sqrt(factors[1]) * (np.eye(8) - mean)
    maps = spread @ _corners_by_pose(homographies)
    return np.asarray(maps @ by_pose @ maps.transpose(0, 2, 1))


def _corners_by_pose(homographies: LocalHomographies) -> Array:
    """Return the derivatives (N, 8, 8) of the corners by the unknowns `POSE`, marker units to px.

    The step of a point z is `δz = d + (s + iθ) z + e z̄ - z Re(q̄ z)` (`design_matrix`). With `a = m z + k z̄`
    and `w = 1 + Re(h̄ a)` its image moves by `δa / w - a Re(h̄ δa) / w²`, where `δa = m δz + k conj(δz)`.
    """
    z: ComplexArray = SQUARE_CORNERS
    steps = {
        RIGHT: np.ones(4, dtype=complex),
        DOWN: np.full(4, 1j),
        TURN: 1j * z,
        GROW: z,
        ANISOTROPY[0]: z.conj(),
        ANISOTROPY[1]: 1j * z.conj(),
        KEYSTONE[0]: -z * z.real,
        KEYSTONE[1]: -z * z.imag,
    }
    dz = np.stack([steps[unknown] for unknown in POSE])
    m, k = homographies.similarities[:, None, None], homographies.anisotropies[:, None, None]
    h = homographies.perspectives.conj()[:, None, None]
    a, da = m * z + k * z.conj(), m * dz + k * dz.conj()
    w = 1 + (h * a).real
    moved = da / w - a * (h * da).real / w**2
    return np.asarray(to_points(moved).reshape(len(homographies), len(POSE), 8).transpose(0, 2, 1))


def _independent_errors(found: Detections) -> Array:
    """Return covariances (N, 8, 8) of corners with equal, independent errors that explain the detection's.

    Four such corners of variance s² give the centre s² / 4, and the heading s² / side².
    """
    centers = 2 * (found.covariances[:, 0, 0] + found.covariances[:, 1, 1])
    headings = found.sides_px**2 * found.covariances[:, 2, 2]
    variances = np.maximum(centers, headings)
    variances = np.where(variances > 0, variances, ASSUMED_STD_PX**2)
    return np.asarray(variances[:, None, None] * np.eye(8))


@dataclass(frozen=True)
class MarkerImages:
    """Appearance of N markers in an image.

    Attributes:
        blacks: (N,) grey levels of black.
        whites: (N,) grey levels of white.
        blurs_cells: (N,) standard deviations of the blur, lens, motion and pixel together, in cells.
    """

    blacks: Array
    whites: Array
    blurs_cells: Array


def measure_marker_images(image: Image, found: Detections, dictionary: str) -> MarkerImages:
    """Return light and blur of detected markers, each from a fit of its own.

    Args:
        image: grey, (height, width), in which the markers were found.
        found: the markers.
        dictionary: name of the markers' dictionary.

    Raises:
        InputError: the image is not a grey one of 8 bits, or there is no such dictionary.
    """
    image = check_grey(image)
    if not len(found):
        return MarkerImages(*np.zeros((3, 0)))
    start = LocalHomographies.of_quads(found.corners_px)
    noise = image_noise(image)
    fits, _ = fit_any_blur(image, dictionary, found.ids, start, START_SIGMA_PX, OWN_PLANES, noise, alone=True)
    cells_px = fits.homographies.sides_px() / cells_per_side(dictionary)
    return MarkerImages(fits.blacks, fits.blacks + fits.contrasts, fits.sigmas_px / cells_px)
