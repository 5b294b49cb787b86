"""How markers were fitted: their poses with covariances, and what the fits leave of the pixels."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from skyherd.geometry import SQUARE_CORNERS, Array, BoolArray, IntArray, to_points
from skyherd.markers.dictionary import cells_per_side
from skyherd.messages import Quality
from skyherd.vision.native.records import FIT
from skyherd.vision.photometric.fitting.local_homography import LocalHomographies
from skyherd.vision.photometric.fitting.surroundings import Surroundings
from skyherd.vision.row_record import RowRecord

MAX_LOG_BLUR = 0.5
"""Largest change of a blur's logarithm that a fit is believed. Chosen: the model is linear in it, so that a
larger one is not reliable; the next fit, about the blur found, goes on from there."""


@dataclass(frozen=True)
class FitResults(RowRecord):
    """Results of the fits of N markers.

    Attributes:
        ids: (N,) marker ids.
        homographies: where the markers lie in the image.
        covariances: (N, 3, 3) of (u, v, heading), in px², px·rad, rad².
        blacks: (N,) grey levels of black.
        contrasts: (N,) grey levels from black to white.
        noise_stds: (N,) standard deviations of the pixels' residuals, grey levels.
        log_blurs: (N,) logarithm of the blur found over the blur assumed.
        blurs_cells: (N,) standard deviation of the blur assumed, in cells.
        sigmas_px: (N,) standard deviation of the blur found, lens and pixel together, px.
        pixels: (N,) number of pixels used.
        cell_means: (N, n, n) mean residual over each cell, grey levels.
        peaks: (N,) largest absolute residual of a pixel, grey levels.
        moved_px: (N,) how far the last step moved the middles of the sides, px.
        variance_ratios: (N, 2) of positions and headings; see `correlated_noise`.
        boxes: (N,) number of boxes that the ratios are of; 0 for a marker without.
        qualities: (N,) values of `skyherd.messages.Quality`.
        surroundings: of the markers, as the fits found them.
        besides: (N,) mean residual of the pixels beside the marker, grey levels.
        log_odds: (N,) that it is this marker (`photometric.evidence.likelihood`); NaN where the fit alone
            decided.
    """

    ids: IntArray
    homographies: LocalHomographies
    covariances: Array
    blacks: Array
    contrasts: Array
    noise_stds: Array
    log_blurs: Array
    blurs_cells: Array
    sigmas_px: Array
    pixels: Array
    cell_means: Array
    peaks: Array
    moved_px: Array
    variance_ratios: Array
    boxes: Array
    qualities: IntArray
    surroundings: Surroundings
    besides: Array
    log_odds: Array

    @property
    def corners_px(self) -> Array:
        """Corners (N, 4, 2) of the fitted markers, px."""
        return to_points(self.homographies.images(SQUARE_CORNERS))

    @classmethod
    def of_records(
        cls, ids: IntArray, fits: npt.NDArray[np.void], cell_means: Array, blurs: Array
    ) -> "FitResults":
        """Return the results of records (N,) of `FIT`.

        Args:
            ids: (N,) marker ids.
            fits: (N,) records.
            cell_means: (N, n, n) mean residual over each cell, grey levels.
            blurs: (N,) standard deviations of the blurs that were assumed, in marker sides.
        """
        return cls(
            ids=ids,
            homographies=LocalHomographies.of_records(fits["homography"]),
            cell_means=cell_means,
            blurs_cells=blurs * cell_means.shape[1],
            qualities=np.full(ids.size, Quality.PHOTOMETRIC.value),
            log_odds=np.full(ids.size, np.nan),
            surroundings=Surroundings.of_records(fits["surroundings"]),
            **{name: fits[name] for name in FIT.names or () if name not in ("homography", "surroundings")},
        )

    def records(self) -> tuple[npt.NDArray[np.void], Array, Array]:
        """Return the records (N,) of `FIT`, cell means and blurs, in marker sides, of `of_records`."""
        records = np.empty(self.ids.size, dtype=FIT)
        records["homography"], records["surroundings"] = (
            self.homographies.records(),
            self.surroundings.records(),
        )
        for name in FIT.names or ():
            if name not in ("homography", "surroundings"):
                records[name] = getattr(self, name)
        return records, self.cell_means, self.blurs_cells / self.cell_means.shape[1]

    def print_contrasts(self) -> Array:
        """Return the print contrasts (N,), a share of white; see the function of this name."""
        return print_contrasts(self.blacks, self.contrasts)


def print_contrasts(blacks: Array, contrasts: Array) -> Array:
    """Return the print contrasts (N,), `(white - black) / white`.

    Light falls on black and white alike, so that this ratio depends on the print alone: it is the same in sun
    and shade.
    """
    return np.asarray(contrasts / np.maximum(blacks + contrasts, 1.0))


def weighted_median(values: Array, weights: Array) -> float:
    """Return the value, of (N,), at which the weights (N,), summed in order of value, reach one half."""
    order = np.argsort(values)
    total = np.cumsum(weights[order])
    return float(values[order][np.searchsorted(total, total[-1] / 2)])


def no_fit_results(dictionary: str) -> FitResults:
    """Return results of zero markers, with the array shapes that markers of `dictionary` have."""
    n, empty, points = cells_per_side(dictionary), np.zeros(0), np.zeros(0, dtype=complex)
    scalars = {
        name: empty
        for name in (
            "blacks",
            "contrasts",
            "noise_stds",
            "log_blurs",
            "blurs_cells",
            "sigmas_px",
            "pixels",
            "peaks",
            "besides",
        )
    }
    return FitResults(
        ids=np.zeros(0, dtype=np.int64),
        homographies=LocalHomographies(points, points, points, points),
        covariances=np.zeros((0, 3, 3)),
        cell_means=np.zeros((0, n, n)),
        moved_px=empty,
        variance_ratios=np.ones((0, 2)),
        boxes=empty,
        qualities=np.zeros(0, dtype=np.int64),
        surroundings=Surroundings.of_cards(0),
        log_odds=empty,
        **scalars,
    )


def replaced(
    fits: FitResults, good: BoolArray, rows: IntArray, others: FitResults
) -> tuple[FitResults, BoolArray]:
    """Return fits with those at indices `rows` replaced, which are then good."""
    good = good.copy()
    good[rows] = True
    return fits.put(rows, others), good
