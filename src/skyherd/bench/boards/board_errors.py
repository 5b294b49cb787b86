r"""What a board itself has wrong, learned from all detectors and images together.

Print, paper and the grid of a monitor displace each corner by δ from where the layout has it. All images
share δ, so that least squares finds it: Σ w |e - J δ|², with the residuals e of every detector's fits, the
fits' Jacobians J from the board to the image, and weights w of one over the variance of the detector in its
set.
What a homography and a polynomial explain is no error of the board, and stays 0.

For the residuals of an image, δ comes from the *other* images: with S = Σ w JᵀJ and the image's own share
S_i, b_i = Σ w Jᵀ e of it, leaving it out moves δ by -(S - S_i)⁻¹ b_i. How far the images disagree about δ
says how uncertain it is: its covariance, one of n images left out, is (n / (n - 1))² Σ S⁻¹ b_i b_iᵀ S⁻¹.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from skyherd.bench.boards.board_fit import BoardFit, robust_sigma
from skyherd.geometry import Array

PASSES = 12
"""Number of passes over all residuals. Chosen: the fits take part of δ away, so that a pass leaves a share of
it, a tenth to a third; what is left after twelve is below a thousandth."""

FEWEST_IMAGES = 3
"""Fewest images in which a marker must be seen for its δ to be learned; of fewer it stays 0. Chosen: with one
image left out, two remain."""


@dataclass(frozen=True)
class Fitted:
    """A fit, and where it is from.

    Attributes:
        set_name: of the image's set.
        image: number of the image among all images of the board.
        detector: whose fit it is.
        fit: of the board to what the detector found.
    """

    set_name: str
    image: int
    detector: str
    fit: BoardFit


@dataclass(frozen=True)
class BoardErrors:
    """Errors of one board.

    Attributes:
        displacements: (K, 4, 2) δ of each corner, in marker sides; 0 where too little is known.
        without: (I, K, 4, 2) the same, from all images but one.
        variances: (K, 8, 8) covariance of the corners' coordinates in `without`, in squared marker sides.
    """

    displacements: Array
    without: Array
    variances: Array


def learn_board_errors(fits: Sequence[Fitted], markers: int, images: int) -> BoardErrors:
    """Learn the errors of a board with this many markers from all fits to it in this many images."""
    delta = np.zeros((markers, 4, 2))
    for _ in range(PASSES):
        sigmas = detector_sigmas(fits, delta)
        whole, pull, seen = _sums(fits, sigmas, delta, markers, images)
        enough = (seen.sum(axis=0) >= FEWEST_IMAGES)[:, None, None]
        delta = delta + np.where(enough, _solved(whole.sum(axis=0), pull.sum(axis=0)), 0.0)
    whole, pull, seen = _sums(fits, sigmas, delta, markers, images)
    without = delta - np.where(enough, _solved(whole.sum(axis=0) - whole, pull), 0.0)
    moved = np.where(enough, _solved(whole.sum(axis=0), pull), 0.0).reshape(images, markers, 8)
    counts = np.maximum(seen.sum(axis=0), FEWEST_IMAGES)[:, None, None]
    variances = np.einsum("ikx,iky->kxy", moved, moved) * (counts / (counts - 1)) ** 2
    return BoardErrors(delta, without, variances)


def detector_sigmas(fits: Sequence[Fitted], delta: Array | None) -> dict[tuple[str, str], float]:
    """Robust standard deviation of the corners' residuals, px, of each detector in each set."""
    values: dict[tuple[str, str], list[Array]] = {}
    for one in fits:
        values.setdefault((one.set_name, one.detector), []).append(one.fit.raw(delta).ravel())
    return {key: robust_sigma(np.concatenate(found)) for key, found in values.items()}


def _sums(
    fits: Sequence[Fitted], sigmas: dict[tuple[str, str], float], delta: Array, markers: int, images: int
) -> tuple[Array, Array, Array]:
    """Of each image: Σ w JᵀJ (I, K, 4, 2, 2), Σ w Jᵀe (I, K, 4, 2), and who was seen (I, K)."""
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
    """Solutions (..., 2) of `whole` x = `pull`; 0 where nothing is known."""
    known = np.linalg.det(whole) > 0
    safe = np.where(known[..., None, None], whole, np.eye(2))
    return np.where(known[..., None], np.linalg.solve(safe, pull[..., None])[..., 0], 0.0)
