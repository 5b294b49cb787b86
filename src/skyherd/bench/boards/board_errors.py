r"""Errors of a board itself, estimated from all detectors and images together.

Print, paper and the pixel grid of a monitor displace each corner by δ from the layout. All images share δ,
so that least squares finds it: Σ w |e - J δ|². Here e are the residuals of every detector's fits, J the fits'
Jacobians from the board to the image, and w one over the variance of the detector in its set. Displacements
that a homography and a polynomial explain are not board errors, and stay 0.

For the residuals of an image, δ comes from the *other* images. With S = Σ w JᵀJ, and the image's own share
S_i and b_i = Σ w Jᵀ e, leaving it out moves δ by -(S - S_i)⁻¹ b_i. The disagreement between images gives the
uncertainty of δ. Its covariance, one of n images left out, is (n / (n - 1))² Σ S⁻¹ b_i b_iᵀ S⁻¹.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from skyherd.bench.boards.board_fit import BoardFit, robust_sigma
from skyherd.geometry import Array

PASSES = 12
"""Number of passes over all residuals. Chosen: the fits absorb a part of δ, so that a pass leaves a tenth to
a third of it; after twelve, less than a thousandth is left."""

MIN_IMAGES = 3
"""Minimum number of images of a marker for which δ is estimated; with fewer it stays 0. Chosen: with one
image left out, two remain."""


@dataclass(frozen=True)
class Fitted:
    """A fit and its origin.

    Attributes:
        set_name: set of the image.
        image: number of the image among all images of the board.
        detector: detector of the fit.
        fit: fit of the board to the detections.
    """

    set_name: str
    image: int
    detector: str
    fit: BoardFit


@dataclass(frozen=True)
class BoardErrors:
    """Errors of one board.

    Attributes:
        displacements: (K, 4, 2) δ of each corner, in marker sides; 0 with too little data.
        without: (I, K, 4, 2) the same, from all images but one.
        variances: (K, 8, 8) covariance of the corners' coordinates in `without`, in squared marker sides.
    """

    displacements: Array
    without: Array
    variances: Array


def learn_board_errors(fits: Sequence[Fitted], markers: int, images: int) -> BoardErrors:
    """Estimate the errors of a board with this many markers from all its fits in this many images."""
    delta = np.zeros((markers, 4, 2))
    for _ in range(PASSES):
        sigmas = detector_sigmas(fits, delta)
        whole, pull, seen = _sums(fits, sigmas, delta, markers, images)
        enough = (seen.sum(axis=0) >= MIN_IMAGES)[:, None, None]
        delta = delta + np.where(enough, _solved(whole.sum(axis=0), pull.sum(axis=0)), 0.0)
    whole, pull, seen = _sums(fits, sigmas, delta, markers, images)
    without = delta - np.where(enough, _solved(whole.sum(axis=0) - whole, pull), 0.0)
    moved = np.where(enough, _solved(whole.sum(axis=0), pull), 0.0).reshape(images, markers, 8)
    counts = np.maximum(seen.sum(axis=0), MIN_IMAGES)[:, None, None]
    variances = np.einsum("ikx,iky->kxy", moved, moved) * (counts / (counts - 1)) ** 2
    return BoardErrors(delta, without, variances)


def detector_sigmas(fits: Sequence[Fitted], delta: Array | None) -> dict[tuple[str, str], float]:
    """Return the robust standard deviation of corner residuals, px, of each detector in each set."""
    values: dict[tuple[str, str], list[Array]] = {}
    for one in fits:
        values.setdefault((one.set_name, one.detector), []).append(one.fit.raw(delta).ravel())
    return {key: robust_sigma(np.concatenate(found)) for key, found in values.items()}


def _sums(
    fits: Sequence[Fitted], sigmas: dict[tuple[str, str], float], delta: Array, markers: int, images: int
) -> tuple[Array, Array, Array]:
    """Return Σ w JᵀJ (I, K, 4, 2, 2), Σ w Jᵀe (I, K, 4, 2) and visibility (I, K) of each image."""
    whole = np.zeros((images, markers, 4, 2, 2))
    pull = np.zeros((images, markers, 4, 2))
    seen = np.zeros((images, markers), dtype=bool)
    for one in fits:
        fit, keep = one.fit, one.fit.fitted
        weight = 1.0 / max(sigmas[one.set_name, one.detector], np.finfo(float).tiny) ** 2
        back = weight * fit.jacobians[keep].swapaxes(2, 3)
        at = (one.image, fit.rows[keep])
        whole[at] += back @ fit.jacobians[keep]
        pull[at] += (back @ fit.raw(delta)[keep][..., None])[..., 0]
        seen[at] = True
    return whole, pull, seen


def _solved(whole: Array, pull: Array) -> Array:
    """Return the solutions (..., 2) of `whole` x = `pull`; 0 where singular."""
    known = np.linalg.det(whole) > 0
    safe = np.where(known[..., None, None], whole, np.eye(2))
    return np.where(known[..., None], np.linalg.solve(safe, pull[..., None])[..., 0], 0.0)
