"""Markers that are covered in part, fitted by what is seen of them.

Least squares hear every pixel, so that a neighbour's card over a corner, a leaf or a cable pulls at the pose.
Here pixels that leave more than a limit are left out and the others fitted again. The limit falls from half
the contrast, which no noise reaches, to `CUT` deviations of the noise: what no pose explains goes first, and
by the time that edges count the pose is nearly right (graduated non-convexity: Blake and Zisserman, Visual
Reconstruction, 1987).
"""

from dataclasses import replace

import numpy as np

from skyherd.geometry import Array
from skyherd.markers.dictionary import cells_per_side
from skyherd.vision.grey import Image
from skyherd.vision.photometric.design_matrix import BLACK, CONTRAST, MIDDLE_GREY, PIXELS, POSE, SQUEEZE
from skyherd.vision.photometric.fit import common_plane, looks_of, stepped
from skyherd.vision.photometric.fit_result import Fits, fits_of
from skyherd.vision.photometric.pixel_samples import Taken
from skyherd.vision.photometric.plane import Plane

CUT = 4.0
"""Deviations of the noise beyond which a pixel is left out in the end: one in 16000 by chance."""

FALL, LAST_ROUNDS = 0.5, 2
"""By how much the limit falls in each round, and rounds at the last one."""

LEAST_SEEN = 0.5
"""Of a cell with a bit so much must be seen, and explained, for the bit to be known."""


def fit_visible(
    image: Image, dictionary: str, fits: Fits, sigma_px: float, plane: Plane, noise: float
) -> Fits:
    """The same markers, fitted by those of their pixels that agree on a pose.

    Args:
        image: grey, (height, width).
        dictionary: of the markers.
        fits: N of them, at least one, as all their pixels have them.
        sigma_px: blur of lens and pixel together.
        plane: that all the image's markers seem to lie on. How these are squeezed they tell by themselves:
            what covers them may have had its part in it.
        noise: standard deviation of a pixel, grey levels.

    Returns:
        The fits. A cell of the border that is not seen leaves nothing; one with a bit leaves as much as a
        wrong one does, so that a marker some bit of which is hidden is never verified.
    """
    n_cells, middle = cells_per_side(dictionary), complex(image.shape[1] - 1, image.shape[0] - 1) / 2
    looks = looks_of(dictionary, fits.ids, sigma_px / fits.shapes.sides_px(), plane, noise)
    looks = replace(looks, ratios=fits.blacks / fits.contrasts)
    rows, shapes = np.arange(fits.ids.size), fits.shapes
    values = np.zeros((rows.size, PIXELS))
    values[:, BLACK], values[:, CONTRAST] = fits.blacks - MIDDLE_GREY, fits.contrasts
    taken = Taken(rows.size)
    limits = fits.contrasts / 2
    for _ in range(_rounds(fits.contrasts, noise)):
        values[:, POSE] = 0.0  # the last round's step was taken
        taken.take(image, rows, shapes, looks, explained=(values, limits))
        solved = taken.solved()
        plane, squeezes = common_plane(solved, shapes, middle, np.ones(rows.size, dtype=bool))
        solved = solved.holding(SQUEEZE, squeezes)
        values = solved.values.copy()
        shapes, moved_px = stepped(solved, shapes)
        shapes = replace(shapes, horizons=plane.horizons(shapes.centers - middle))
        limits = np.maximum(FALL * limits, CUT * np.minimum(noise, solved.noises()))
    means, peaks = taken.leavings(rows, solved, n_cells)
    means = _as_wrong_where_hidden(means, taken.cells_seen(rows, n_cells), solved.contrasts())
    variances = plane.variances(shapes.centers - middle)
    return fits_of(fits.ids, solved, shapes, (means, peaks), moved_px, sigma_px, variances)


def _rounds(contrasts: Array, noise: float) -> int:
    """As many as the limit takes to fall to `CUT` deviations of the noise, and `LAST_ROUNDS`."""
    falls = np.log(CUT * noise / (contrasts.max() / 2)) / np.log(FALL)
    return int(np.ceil(max(falls, 0.0))) + LAST_ROUNDS


def _as_wrong_where_hidden(cell_means: Array, seen: Array, contrasts: Array) -> Array:
    """(N, n, n) what cells leave: their mean where enough of them is seen, else all there is for a bit."""
    of_bits = np.zeros(seen.shape[1:])
    of_bits[1:-1, 1:-1] = 1.0
    return np.where(seen < LEAST_SEEN, of_bits * contrasts[:, None, None], cell_means)
