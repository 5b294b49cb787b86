"""Errors from residuals: medians, the common error floor, and consistency of covariances.

**Errors.** The standardised residuals of a marker's corners give its centre's error (their mean), the
corners' errors, and the heading's (the best-fitting rotation). The learned errors of the board are uncertain
themselves. Their variance is subtracted, averaged over all markers of a set.

**The floor.** Common errors of two independent detectors come from the board, the lens, the shutter or the
image. The covariance of their residuals measures them. It is estimated from the spread of sum and difference,
(V(a + b) - V(a - b)) / 4. Image noise also moves both detectors alike. Added noise measures this effect: the
covariance of the shifts, scaled to the image's own noise, is subtracted. The floor is that of the two most
accurate detectors of different families.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from skyherd.bench.boards.board_errors import BoardErrors, Fitted
from skyherd.bench.boards.board_fit import BoardFit, robust_sigma
from skyherd.bench.photographs.confirmation import family
from skyherd.geometry import Array, to_complex

RAYLEIGH_MEDIAN = float(np.sqrt(2 * np.log(2)))
"""Median length of a vector of two independent standard normal variables. Derived."""

MIN_COMMON = 20
"""Minimum number of common markers of two detectors for a floor. Chosen: a variance from fewer has an error
above a third."""

QUANTITIES = ("center", "corner", "heading")
"""Quantities with an error: centre and corners in px, heading in degrees."""


@dataclass(frozen=True)
class MarkerErrors:
    """Errors of N markers that one detector found in the images of one set.

    Attributes:
        keys: (N, 2) number of the image, and id.
        center: (N, 2) of the centre, px.
        corner: (N, 8) of the corners, px.
        heading: (N, 1) degrees.
        learned: variances of the board's learned errors included here, by the quantity's name, per axis.
        covariances: (N, 3, 3) that the detector reports, of (u, v, heading), in px and rad.
        outliers: number of markers far from their predicted positions; not among the N.
    """

    keys: Array
    center: Array
    corner: Array
    heading: Array
    learned: dict[str, float]
    covariances: Array
    outliers: int

    def values(self, quantity: str) -> Array:
        """Return the errors (N, axes) of a quantity."""
        return np.asarray(getattr(self, quantity))

    def share_of_detector(self, quantity: str) -> float:
        """Return the length factor that removes the variance of the board's learned errors."""
        variance = robust_sigma(self.values(quantity)) ** 2
        return float(np.sqrt(max(1 - self.learned[quantity] / variance, 0.0))) if variance > 0 else 1.0

    def median(self, quantity: str) -> float:
        """Return the median distance of centre or corners from their prediction, px, or |heading|, deg."""
        lengths = _lengths(self.values(quantity))
        return float(np.median(lengths)) * self.share_of_detector(quantity)

    def percentile(self, quantity: str, percent: float) -> float:
        """Return a percentile of the distances of `median`."""
        lengths = _lengths(self.values(quantity))
        return float(np.percentile(lengths, percent)) * self.share_of_detector(quantity)

    def nees(self, quantity: str, floor: float) -> float | None:
        """Return the mean of error² over the reported variance plus the floor's; None without any.

        Args:
            quantity: `center` or `heading`.
            floor: standard deviation of each axis that all detectors share, in the quantity's unit.
        """
        known = self.covariances.any(axis=(1, 2))
        if not known.any():
            return None
        diagonal = self.covariances[known].diagonal(axis1=1, axis2=2)
        variances = diagonal[:, :2] if quantity == "center" else np.degrees(np.degrees(diagonal[:, 2:]))
        errors = self.values(quantity)[known] * self.share_of_detector(quantity)
        return float(np.mean(errors**2 / (variances + floor**2)))


def collect_errors(fits: Sequence[Fitted], learned: BoardErrors) -> MarkerErrors | None:
    """Collect the errors of all fits of one detector in one set; None if there is no marker."""
    parts = [(one, one.fit.standardised(learned.without[one.image])) for one in fits]
    keys, centers, corners, headings, covariances, spreads = [], [], [], [], [], []
    outliers = 0
    for one, residuals in parts:
        keep = one.fit.fitted & np.isfinite(residuals).all(axis=(1, 2))
        outliers += int((~one.fit.fitted).sum())
        ids = one.fit.ids[keep]
        keys.append(np.column_stack([np.full(ids.size, one.image), ids]))
        centers.append(residuals[keep].mean(axis=1))
        corners.append(residuals[keep].reshape(-1, 8))
        headings.append(turns_deg(one.fit, residuals)[keep, None])
        covariances.append(one.fit.covariances[keep])
        spreads.append(_learned_variances(one.fit, learned)[keep])
    if not sum(map(len, keys)):
        return None
    center, corner, heading = np.concatenate(spreads).mean(axis=0)
    return MarkerErrors(
        keys=np.concatenate(keys),
        center=np.concatenate(centers),
        corner=np.concatenate(corners),
        heading=np.concatenate(headings),
        learned={"center": float(center), "corner": float(corner), "heading": float(heading)},
        covariances=np.concatenate(covariances),
        outliers=outliers,
    )


def turns_deg(fit: BoardFit, residuals: Array) -> Array:
    """Return the small rotations (..., M), degrees, that best fit corner residuals (..., M, 4, 2)."""
    corners = to_complex(fit.predicted_px)
    arms = corners - corners.mean(axis=1, keepdims=True)
    crossed = (arms.conj() * to_complex(residuals)).imag.sum(axis=-1)
    return np.asarray(np.degrees(crossed / (np.abs(arms) ** 2).sum(axis=1)))


def find_floor(
    errors: Mapping[str, MarkerErrors], shifts: Mapping[str, MarkerErrors], share: float
) -> dict[str, float | None]:
    """Estimate the common standard deviation per axis, by quantity; None without two families.

    Args:
        errors: errors of each detector in a set.
        shifts: shifts of each detector's results by added noise, in the same form.
        share: variance of the images' own noise over that of the added noise.
    """
    floors: dict[str, float | None] = {}
    for quantity in QUANTITIES:
        ranked = sorted(errors, key=lambda name: errors[name].median(quantity))
        pair = next(
            ((a, b) for k, b in enumerate(ranked) for a in ranked[:k] if family(a) != family(b)), None
        )
        shared = None if pair is None else covariance(errors[pair[0]], errors[pair[1]], quantity)
        if pair is None or shared is None:
            floors[quantity] = None
            continue
        learned = errors[pair[0]].learned[quantity]
        noise = 0.0
        if pair[0] in shifts and pair[1] in shifts:
            noise = share * (covariance(shifts[pair[0]], shifts[pair[1]], quantity) or 0.0)
        floors[quantity] = float(np.sqrt(max(shared - noise - learned, 0.0)))
    return floors


def covariance(one: MarkerErrors, other: MarkerErrors, quantity: str) -> float | None:
    """Return the robust covariance, per axis, of two detectors' errors; None of too few common markers."""
    rows = {tuple(key): row for row, key in enumerate(other.keys.tolist())}
    pairs = [(k, rows[tuple(key)]) for k, key in enumerate(one.keys.tolist()) if tuple(key) in rows]
    if len(pairs) < MIN_COMMON:
        return None
    mine, others = np.array(pairs).T
    a, b = one.values(quantity)[mine], other.values(quantity)[others]
    return (robust_sigma(a + b) ** 2 - robust_sigma(a - b) ** 2) / 4


def only(errors: MarkerErrors, keys: set[tuple[int, ...]]) -> MarkerErrors:
    """Select the errors of some markers."""
    keep = np.array([tuple(key) in keys for key in errors.keys.tolist()], dtype=bool)
    parts = {name: getattr(errors, name)[keep] for name in ("keys", *QUANTITIES, "covariances")}
    return replace(errors, **parts)


def _learned_variances(fit: BoardFit, learned: BoardErrors) -> Array:
    """Return the variances (M, 3) per axis of centre, corners and heading from the learned board errors.

    In px² and, for the heading, deg².
    """
    count = len(fit.ids)
    apart = np.zeros((count, 4, 2, 4, 2))
    for corner in range(4):
        apart[:, corner, :, corner] = fit.jacobians[:, corner]
    moves = apart.reshape(count, 4, 2, 8)
    turns = turns_deg(fit, moves.transpose(3, 0, 1, 2))
    center = moves.mean(axis=1)
    spread = learned.variances[fit.rows]
    of_center = np.einsum("mix,mxy,miy->m", center, spread, center) / 2
    of_corner = np.einsum("mcix,mxy,mciy->m", moves, spread, moves) / 8
    of_heading = np.einsum("xm,mxy,ym->m", turns, spread, turns)
    return np.column_stack([of_center, of_corner, of_heading])


def _lengths(values: Array) -> Array:
    """Return the lengths of the vectors (u, v) in rows, or magnitudes of single values."""
    if values.shape[1] == 1:
        return np.abs(values[:, 0])
    return np.asarray(np.linalg.norm(values.reshape(-1, 2), axis=1))
