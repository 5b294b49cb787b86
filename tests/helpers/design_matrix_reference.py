"""The model's columns at the pixels of markers, for the reference of the fit in NumPy.

Pixels and columns are those of the compiled stages. `test_design_matrix` and `test_elliptic_blur` check them.
"""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import numpy.typing as npt
from tests.helpers.fit_stages import BLOCK_PX, MARKER, stages
from tests.helpers.homography_reference import blur_anisotropies

from skyherd.geometry import Array, BoolArray, ComplexArray, IntArray
from skyherd.vision.grey import Image
from skyherd.vision.native.records import UNKNOWNS, Floats
from skyherd.vision.photometric.fitting.appearance import TEXTURE, MarkerAppearances
from skyherd.vision.photometric.fitting.design_matrix import (
    BLACK,
    GROUND,
    MAX_GROWTH,
    MIN_VARIANCE_PX2,
    SIGMA_LIMITS,
    STEEP_ANISOTROPY,
)
from skyherd.vision.photometric.fitting.local_homography import LocalHomographies

PIXEL_ROW = UNKNOWNS
"""Index of the pixels' own values, which are stored beside the model's columns."""

MIDDLE_GREY = 128.0
"""Grey level that is subtracted from the pixels, as in `fit.h`."""


class DesignMatrices:
    """The pixels of some of an image's markers, and the model's columns at them.

    Attributes:
        rows: (N,) indices of these markers among those of the image.
        bounds: (N + 1,) the pixels of marker k are those from `bounds[k]` to `bounds[k + 1]`.
        places: (P, 2) marker coordinates x and y of the pixels, in sides.
        pixels: (P, 2) lines v and columns u of the pixels in the image.
        counts: (N,) number of pixels used of each marker.
        columns: (P, 16) the model's columns and, in column `PIXEL_ROW`, the pixels less `MIDDLE_GREY`, all
            times the pixels' weights; 0 for pixels that are not used.
        bends: (P, 3) T_xx, T_xy and T_yy times the weights, of markers whose blur is drawn as an ellipse;
            (0, 3) where no blur is.
    """

    def __init__(
        self, image: Image, rows: IntArray, homographies: LocalHomographies, appearances: MarkerAppearances
    ) -> None:
        """Read the pixels of markers with the given homographies and appearances, each of N.

        Args:
            image: grey, (height, width).
            rows: (N,) indices of these markers among those of the image.
            homographies: of these markers.
            appearances: of these markers.
        """
        self.rows = rows
        markers = marker_records(homographies, appearances)
        self._data = stages().list_pixels(markers, image.shape)
        self.counts, self.bounds = self._data.counts, np.concatenate([[0], np.cumsum(self._data.counts)])
        self.places, self.pixels = map(self._data.by_pixels, (self._data.places, self._data.pixels))
        self.bends = np.zeros((0, 3), dtype=np.float32)
        image, elliptic = np.ascontiguousarray(image), is_elliptic(appearances, homographies)
        if elliptic.any() or appearances.surroundings.is_bare().any():
            self._fill_apart(image, markers, homographies, appearances, elliptic)
        else:
            stages().fill_round(image, markers, appearances.cells, appearances.texture, self._data)
        self.columns = self._data.by_pixels(self._data.columns)

    def _fill_apart(
        self,
        image: Image,
        markers: npt.NDArray[np.void],
        homographies: LocalHomographies,
        appearances: MarkerAppearances,
        elliptic: BoolArray,
    ) -> None:
        """Fill in the pixels of markers of which some are `elliptic` (N,) or bare, run by run of a kind."""
        bends = np.zeros((len(self._data.columns), 3, BLOCK_PX), dtype=np.float32)
        tables = blur_tables(homographies, markers["sigma"], appearances.streak_px2 or 0j)
        markers["keystone"] = np.where(elliptic, homographies.keystones(), markers["keystone"])
        textures = textures_over_noise(appearances)
        runs = [
            0,
            *(np.flatnonzero(np.diff(elliptic) | (np.diff(textures) != 0)) + 1).tolist(),
            self.rows.size,
        ]
        for first, end in pairwise(runs):
            about = appearances.cells, float(textures[first]), self._data
            if elliptic[first]:
                stages().fill_elliptic(image, markers, tables, *about, bends, first, end)
            else:
                stages().fill_round(image, markers, *about, first, end)
        self.bends = self._data.by_pixels(bends)

    def leave_out(self, pixels: BoolArray) -> None:
        """Set the columns of pixels, a mask (P,), to 0, so that they are not used."""
        self.columns[pixels] = 0.0
        left_out = np.zeros(self._data.places[:, 0].shape, dtype=bool)
        left_out[self._data.is_pixel()] = pixels
        np.moveaxis(self._data.columns, 1, 2)[left_out] = 0.0

    def gram_matrices(self) -> Floats:
        """Return the inner products (N, 16, 16) of the weighted columns and the pixels."""
        return stages().gram_matrices(self._data)

    def residuals(self, solutions: Array) -> Floats:
        """Return the weighted residuals (P,), grey levels, of the model at `solutions` (N, 15)."""
        return stages().residuals(self._data, np.ascontiguousarray(solutions, dtype=np.float32))

    def cell_residuals(self, solutions: Array, n_cells: int) -> tuple[Array, Array, Array]:
        """Return what the model at `solutions` (N, 15) leaves of the pixels, grey levels.

        Returns:
            The mean residual over each cell (N, n, n), the largest absolute residual of a pixel (N,), and the
            mean residual of the pixels beside the marker (N,).
        """
        sums, used, _, peaks, besides = self._sums_over_cells(solutions, n_cells)
        return sums / np.maximum(used, 1), peaks, besides

    def ground_textures(self, solutions: Array, noise: float) -> Array:
        """Return the textures (N,) of the ground around markers without cards, grey levels.

        `noise` is the standard deviation of a pixel, grey levels.
        """
        textures = np.zeros(self.rows.size)
        left = self.residuals(solutions)
        for row, (begin, end) in enumerate(pairwise(self.bounds.tolist())):
            columns = self.columns[begin:end].astype(float)
            weighted = columns[:, BLACK] > 0
            weights = np.where(weighted, columns[:, BLACK], 1.0)
            shares, own = columns[:, GROUND] / weights, left[begin:end] / weights
            counted = weighted & (shares > 0.5)
            excess = (own[counted] ** 2 - noise**2).sum() / max((shares[counted] ** 2).sum(), 1e-12)
            textures[row] = np.sqrt(max(excess, 0.0))
        return textures

    def squared_box_sums(
        self, solutions: Array, influences: Array, picked: IntArray, box_px: int
    ) -> tuple[Array, Array, IntArray]:
        """Return how influences times residuals add up over boxes of pixels, for some of the markers.

        Args:
            solutions: (N, 15) of the model.
            influences: (N, K, 15) by how much each of K quantities changes with what the model's columns do.
            picked: (P,) which of these N markers.
            box_px: side of the small boxes; large ones have twice as much.

        Returns:
            The sums (P, K) over all small boxes, and over all large ones, of the square of what influence
            times residual adds up to in a box; and the number (P,) of large boxes that have pixels.
        """
        model, by = (np.ascontiguousarray(factors, dtype=np.float32) for factors in (solutions, influences))
        return stages().squared_box_sums(self._data, model, by, picked, box_px)

    def _sums_over_cells(self, solutions: Array, n_cells: int) -> tuple[Array, Array, Array, Array, Array]:
        """Return the result of `FitStages.cell_sums`."""
        model = np.ascontiguousarray(solutions, dtype=np.float32)
        return stages().cell_sums(self._data, model, n_cells)


def marker_records(homographies: LocalHomographies, appearances: MarkerAppearances) -> npt.NDArray[np.void]:
    """Return the records (N,), `MARKER`, from which markers are drawn.

    In the coordinates of a marker that is anisotropic by e = k / m, blur that is round in the image has
    standard deviations `σ |1 ∓ e| / sqrt(1 + |e|²)` along x and y, with σ that of their mean variance
    (`LocalHomographies.blurs`).
    """
    markers = np.zeros(len(homographies), dtype=MARKER)
    limits, relative = appearances.read_limits, homographies.anisotropies / homographies.similarities
    strips = limits / (1 - np.minimum(np.abs(homographies.keystones()) * np.sqrt(2) * limits, MAX_GROWTH))
    right = homographies.similarities + homographies.anisotropies
    down = homographies.similarities - homographies.anisotropies
    markers["center"], markers["perspective"] = homographies.centers, homographies.perspectives
    markers["x_axis"], markers["y_axis"] = homographies.axes()
    markers["limit"], markers["strip"] = limits, strips
    markers["height_px"] = strips * (np.abs(right.imag) + np.abs(down.real))
    markers["sigma"] = np.clip(appearances.sigmas, *SIGMA_LIMITS)
    markers["black_ratio"] = appearances.black_ratios
    markers["half_card"] = np.where(appearances.reaches_ground, appearances.half_card, np.inf)
    bare = appearances.surroundings.is_bare()
    markers["ground_level"], markers["is_bare"] = np.where(bare, appearances.surroundings.levels, 0.0), bare
    spread = np.sqrt(1 + np.abs(relative) ** 2)
    markers["x_stretch"], markers["y_stretch"] = np.abs(1 - relative) / spread, np.abs(1 + relative) / spread
    if appearances.round_in_image:
        markers["keystone"] = homographies.perspectives * homographies.similarities.conj()
        markers["anisotropy"] = blur_anisotropies(homographies)
    return markers


def taken(appearances: MarkerAppearances, rows: IntArray) -> MarkerAppearances:
    """Return the appearances of the markers at indices `rows` (K,)."""
    names = ("cells", "sigmas", "read_limits", "reaches_ground", "black_ratios")
    parts = {name: getattr(appearances, name)[rows] for name in names}
    return replace(appearances, surroundings=appearances.surroundings.take(rows), **parts)


def textures_over_noise(appearances: MarkerAppearances) -> Array:
    """Return the textures (N,) that N markers are drawn with, over the noise, in single precision as in C."""
    around, noise = appearances.surroundings, TEXTURE / appearances.texture
    textures = np.where(around.is_bare(), around.textures / noise, appearances.texture)
    return textures.astype(np.float32).astype(float)


def is_elliptic(appearances: MarkerAppearances, homographies: LocalHomographies) -> BoolArray:
    """Return which of N markers have their blur drawn as an ellipse."""
    if appearances.streak_px2 is not None:
        return np.ones(len(homographies), dtype=bool)
    return is_steep(homographies) & appearances.round_in_image


def is_steep(homographies: LocalHomographies) -> BoolArray:
    """Return which of N markers are so anisotropic that their blur is to be drawn as an ellipse."""
    return np.asarray(
        np.abs(homographies.anisotropies) > STEEP_ANISOTROPY * np.abs(homographies.similarities)
    )


def possible_streaks(streak_px2: complex, sigmas_px: Array) -> ComplexArray:
    """Return the streaks (N,) that images of blurs (N,), px, can have: no more than leaves some blur across.

    Args:
        streak_px2: Q of the image, px².
        sigmas_px: (N,) roots of the mean variances of the whole blurs.
    """
    most = np.maximum(sigmas_px**2 - MIN_VARIANCE_PX2, 0.0)
    return np.asarray(streak_px2 * np.minimum(1.0, most / max(abs(streak_px2), 1e-12)))


def blur_tables(homographies: LocalHomographies, sigmas: Array, streak_px2: complex) -> Array:
    """Return the blurs of N markers in their coordinates, (N, 6), in sides squared.

    Args:
        homographies: of the markers.
        sigmas: (N,) roots of the mean variances, in sides, as of `LocalHomographies.blurs`.
        streak_px2: Q of the image, px²; it is cut where a blur has no room for it (`possible_streaks`).

    Returns:
        Variances along x and y and covariance, and by how much each changes with the logarithm of `sigmas`.
    """
    sigmas_px = sigmas / homographies.blurs(1.0)
    squares = sigmas**2
    round_table = _table(-2 * squares * blur_anisotropies(homographies), squares)
    streaks = possible_streaks(streak_px2, sigmas_px)
    return np.hstack([round_table + _table(*_moments(homographies, streaks)), 2 * round_table])


def second_derivative_maps(homographies: LocalHomographies) -> Array:
    """Return how T_xx, T_xy and T_yy of N markers make up the derivatives of T by the parts of Q, (N, 3, 2).

    A change dS of the blur changes T by `(dS_xx T_xx + dS_yy T_yy) / 2 + dS_xy T_xy`, in sides.
    """
    ones = np.ones(len(homographies), dtype=complex)
    tables = np.stack([_table(*_moments(homographies, part * ones)) for part in (1, 1j)], axis=-1)
    return np.asarray(tables[:, [0, 2, 1]] * np.array([0.5, 1.0, 0.5])[:, None])


def _moments(homographies: LocalHomographies, streaks: ComplexArray) -> tuple[ComplexArray, Array]:
    """Return halves of E z² (N,) and E |z|² (N,) that streaks Q (N,), px², add in marker coordinates."""
    m, k, areas = homographies.similarities, homographies.anisotropies, homographies.sides_px() ** 2
    squared = (m.conj() ** 2 * streaks + k**2 * streaks.conj()) / areas**2
    return squared, -2 * (m.conj() * k.conj() * streaks).real / areas**2


def _table(half_squared: ComplexArray, half_absolute: Array) -> Array:
    """Return variances along x and y, and covariance, (N, 3), of half of E z² and of E |z|²."""
    return np.stack(
        [half_absolute + half_squared.real, half_absolute - half_squared.real, half_squared.imag], axis=1
    )
