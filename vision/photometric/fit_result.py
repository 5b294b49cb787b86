"""How markers were fitted: their poses, with covariances, and what the fits leave of the pixels."""

from dataclasses import dataclass

import numpy as np

from skyherd.geometry import Array, IntArray
from skyherd.markers.dictionary import cells_per_side
from skyherd.vision.photometric import design_matrix
from skyherd.vision.photometric.design_matrix import BLACK, BLUR, CONTRAST, MIDDLE_GREY, PIXELS, SQUEEZE
from skyherd.vision.photometric.least_squares import Solved
from skyherd.vision.photometric.local_homography import Shapes
from skyherd.vision.row_record import Rows


@dataclass(frozen=True)
class Fits(Rows):
    """How N markers were fitted.

    Attributes:
        ids: (N,).
        shapes: where they lie.
        covariances: (N, 3, 3) of (u, v, heading).
        blacks: (N,) grey level of black.
        contrasts: (N,) grey levels from black to white.
        noises: (N,) standard deviation of what is left of the pixels, grey levels.
        log_blurs: (N,) by how much the blur differs from what it was taken for.
        blurs_cells: (N,) what it was taken for, in cells.
        pixels: (N,) pixels read.
        cell_means: (N, n, n) mean of what is left over each cell, grey levels.
        peaks: (N,) most that is left of a pixel, grey levels.
        moved_px: (N,) by how much the last step moved the sides.
    """

    ids: IntArray
    shapes: Shapes
    covariances: Array
    blacks: Array
    contrasts: Array
    noises: Array
    log_blurs: Array
    blurs_cells: Array
    pixels: Array
    cell_means: Array
    peaks: Array
    moved_px: Array

    def print_contrasts(self) -> Array:
        """(N,) print contrast of each."""
        return print_contrasts(self.blacks, self.contrasts)


def print_contrasts(blacks: Array, contrasts: Array) -> Array:
    """(N,) `(white - black) / white`: of the print alone, whatever light falls on it."""
    return np.asarray(contrasts / np.maximum(blacks + contrasts, 1.0))


def weighted_median(values: Array, weights: Array) -> float:
    """Of values (N,), where half of the weights (N,) is reached."""
    order = np.argsort(values)
    told = np.cumsum(weights[order])
    return float(values[order][np.searchsorted(told, told[-1] / 2)])


def no_fits(dictionary: str) -> Fits:
    """None at all."""
    n, none, points = cells_per_side(dictionary), np.zeros(0), np.zeros(0, dtype=complex)
    shapes = Shapes(points, points, points, points)
    covariances, cells = np.zeros((0, 3, 3)), np.zeros((0, n, n))
    return Fits(
        np.zeros(0, dtype=np.int64),
        shapes,
        covariances,
        none,
        none,
        none,
        none,
        none,
        none,
        cells,
        none,
        none,
    )


def fits_of(
    ids: IntArray,
    solved: Solved,
    shapes: Shapes,
    leavings: tuple[Array, Array],
    moved_px: Array,
    sigma_px: float,
    squeeze_variances: Array,
) -> Fits:
    """What a solution says of N markers, that took them to these shapes; `leavings` as of `Taken`."""
    cell_means, peaks = leavings
    return Fits(
        ids=ids,
        shapes=shapes,
        covariances=_covariances(solved, shapes, squeeze_variances),
        blacks=solved.values[:, BLACK] + MIDDLE_GREY,
        contrasts=solved.values[:, CONTRAST],
        noises=solved.noises(),
        log_blurs=solved.values[:, BLUR] / solved.contrasts(),
        blurs_cells=sigma_px / shapes.sides_px() * cell_means.shape[1],
        pixels=solved.pixels,
        cell_means=cell_means,
        peaks=peaks,
        moved_px=moved_px,
    )


def _covariances(solved: Solved, shapes: Shapes, squeeze_variances: Array) -> Array:
    """(N, 3, 3) of (u, v, heading): the unknowns' covariance through the marker's shape.

    A step moves the centre by `m d + k d̄` and turns forward by `Re((m + k) / (m - k)) (θ - e_shear)`; shear
    that is held as the plane has it varies as the plane does.
    """
    right, down = shapes.arms + shapes.squeezes, 1j * (shapes.arms - shapes.squeezes)
    turn = (right / (shapes.arms - shapes.squeezes)).real
    to_pose = np.zeros((len(shapes), 3, PIXELS))
    for column, axis in ((design_matrix.RIGHT, right), (design_matrix.DOWN, down)):
        to_pose[:, 0, column], to_pose[:, 1, column] = axis.real, axis.imag
    to_pose[:, 2, design_matrix.TURN], to_pose[:, 2, SQUEEZE[1]] = turn, -turn
    scale = (solved.noises() / solved.contrasts()) ** 2
    covariances = to_pose @ solved.inverses @ to_pose.transpose(0, 2, 1) * scale[:, None, None]
    covariances[:, 2, 2] += turn**2 * squeeze_variances
    return np.asarray(covariances)
