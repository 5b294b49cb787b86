"""The linear model of a marker's pixels around a pose: its design matrix, drawn at the image's own pixels.

With T what a blurred marker looks like (`vision/native/columns.h`) at marker coordinates
z = z(p) = x + iy, the grey level of pixel p is

    I(p) ≈ a + b T + b (T_z · δz + T_log σ δ log σ) + g (1 - A) + (l_x x + l_y y) (r + T) + c T (1 - T),

with these unknowns, 15 in all, of which eight make up a homography:

- black level a and contrast b (white minus black), whose ratio is r = a / b;
- a step of the pose, δz = d + (s + iθ) z + e z̄ - z Re(q̄ z): shift d, scale s, rotation θ, anisotropy e,
  keystone q;
- a change δ log σ of the blur's logarithm;
- ground level g beyond the card, which covers the share A of a pixel;
- light l that changes over the marker;
- a bend c of the tone curve, by which a camera's gamma shifts edges towards black.

The marker and its derivatives are computed *at the image's own pixels* (`vision/native/fit.h`). The image
is never resampled, so that its noise stays white.

Blur that is round in the image is not round in the coordinates of a marker that is anisotropic. An anisotropy
z ↦ z + e z̄ leaves there a blur of variances σ² (1 ∓ 2 e_x) and covariance -2 σ² e_y, to first order, and so
changes T by `- e_x σ² (T_xx - T_yy) - 2 e_y σ² T_xy`. Towards the horizon the marker shrinks by `w^(-3/2)`
with `w = 1 + Re(h̄ m z)`, so that the blur grows in its coordinates, and the anisotropy changes by `- h m̄ z
/ 2`. Blur that differs more along its directions, at a steep tilt or by a streak, is drawn as what it is
(`blur_ellipses`, `vision/native/elliptic_blur.c`).

Ground seen through the blur near the card's edge has a texture, which the model does not describe. Pixels are
therefore weighted by `1 / sqrt(1 + (t (1 - A))²)`, with t the texture's standard deviation over the noise:
texture is noise too, and without the weights the covariance would promise too much.
"""

from itertools import pairwise

import numpy as np
import numpy.typing as npt

from skyherd.geometry import Array, BoolArray, IntArray
from skyherd.vision.grey import Image
from skyherd.vision.native.library import library
from skyherd.vision.native.records import BLOCK_PX, MARKER, UNKNOWNS, Floats
from skyherd.vision.photometric.fitting.appearance import MarkerAppearances
from skyherd.vision.photometric.fitting.blur_ellipses import blur_tables
from skyherd.vision.photometric.fitting.local_homography import LocalHomographies

BLACK, CONTRAST, RIGHT, DOWN, TURN, GROW, BLUR, GROUND = range(8)
"""Indices of the unknowns with one component, in the order of the model's columns."""

ANISOTROPY, LIGHT, KEYSTONE = [8, 9], [10, 11], [12, 13]
"""Indices of the unknowns with two components each."""

TONE = [14]
"""Index of the bend of the tone curve, in a list as those of two components are."""

PIXEL_ROW = UNKNOWNS
"""Index of the pixels' own values, which are stored beside the model's columns."""

POSE = [RIGHT, DOWN, TURN, GROW, *ANISOTROPY, *KEYSTONE]
"""Indices of the unknowns that make up a step of the pose."""

MIDDLE_GREY = 128.0
"""Grey level that is subtracted from the pixels, so that sums of their squares keep their digits in single
precision. Chosen: the middle of the 8-bit range."""

MAX_GROWTH = 0.5
"""Largest share by which a horizon may move a marker's border outwards. Chosen: at a half, the marker is seen
from nearer than its own side; what lies further out is not read."""

SIGMA_LIMITS = 1e-4, 1e4
"""Blurs are drawn as of these limits where they lie beyond, in marker sides. Chosen far outside of what a
marker can be read under: a thousandth of a cell, and ten thousand markers."""


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
        markers = _markers(homographies, appearances)
        self._data = library().list_pixels(markers, image.shape)
        self.counts, self.bounds = self._data.counts, np.concatenate([[0], np.cumsum(self._data.counts)])
        self.places, self.pixels = map(self._data.by_pixels, (self._data.places, self._data.pixels))
        self.bends = np.zeros((0, 3), dtype=np.float32)
        image, elliptic = np.ascontiguousarray(image), appearances.elliptic(homographies)
        if elliptic.any():
            self._fill_apart(image, markers, homographies, appearances, elliptic)
        else:
            library().fill_round(image, markers, appearances.cells, appearances.texture, self._data)
        self.columns = self._data.by_pixels(self._data.columns)

    def _fill_apart(
        self,
        image: Image,
        markers: npt.NDArray[np.void],
        homographies: LocalHomographies,
        appearances: MarkerAppearances,
        elliptic: BoolArray,
    ) -> None:
        """Fill in the pixels of markers of which some are `elliptic` (N,), each run of a kind by itself."""
        bends = np.zeros((len(self._data.columns), 3, BLOCK_PX), dtype=np.float32)
        tables = blur_tables(homographies, markers["sigma"], appearances.streak_px2 or 0j)
        markers["keystone"] = np.where(elliptic, homographies.keystones(), markers["keystone"])
        runs = [0, *(np.flatnonzero(np.diff(elliptic)) + 1).tolist(), self.rows.size]
        about = appearances.cells, appearances.texture, self._data
        for first, end in pairwise(runs):
            if elliptic[first]:
                library().fill_elliptic(image, markers, tables, *about, bends, first, end)
            else:
                library().fill_round(image, markers, *about, first, end)
        self.bends = self._data.by_pixels(bends)

    def leave_out(self, pixels: BoolArray) -> None:
        """Set the columns of pixels, a mask (P,), to 0, so that they are not used."""
        self.columns[pixels] = 0.0
        left_out = np.zeros(self._data.places[:, 0].shape, dtype=bool)
        left_out[self._data.is_pixel()] = pixels
        np.moveaxis(self._data.columns, 1, 2)[left_out] = 0.0

    def gram_matrices(self) -> Floats:
        """Return the inner products (N, 16, 16) of the weighted columns and the pixels."""
        return library().gram_matrices(self._data)

    def residuals(self, solutions: Array) -> Floats:
        """Return the weighted residuals (P,), grey levels, of the model at `solutions` (N, 15)."""
        return library().residuals(self._data, np.ascontiguousarray(solutions, dtype=np.float32))

    def cell_residuals(self, solutions: Array, n_cells: int) -> tuple[Array, Array]:
        """Return what the model at `solutions` (N, 15) leaves of the pixels, grey levels.

        Returns:
            The mean residual over each cell (N, n, n), and the largest absolute residual of a pixel (N,).
        """
        sums, used, _, peaks = self._sums_over_cells(solutions, n_cells)
        return sums / np.maximum(used, 1), peaks

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
        return library().squared_box_sums(self._data, model, by, picked, box_px)

    def _sums_over_cells(self, solutions: Array, n_cells: int) -> tuple[Array, Array, Array, Array]:
        """Residuals, pixels used and pixels read over each cell (N, n, n), and largest residuals (N,)."""
        model = np.ascontiguousarray(solutions, dtype=np.float32)
        return library().cell_sums(self._data, model, n_cells)


def _markers(homographies: LocalHomographies, appearances: MarkerAppearances) -> npt.NDArray[np.void]:
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
    spread = np.sqrt(1 + np.abs(relative) ** 2)
    markers["x_stretch"], markers["y_stretch"] = np.abs(1 - relative) / spread, np.abs(1 + relative) / spread
    if appearances.round_in_image:
        markers["keystone"] = homographies.perspectives * homographies.similarities.conj()
        markers["anisotropy"] = homographies.blur_anisotropies()
    return markers
