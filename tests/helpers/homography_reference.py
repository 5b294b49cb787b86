"""Steps of homographies, and round blur in marker coordinates, in NumPy, as in `homography.h`."""

from dataclasses import replace

import numpy as np

from skyherd.geometry import ComplexArray
from skyherd.vision.photometric.fitting.local_homography import LocalHomographies


def moved(
    before: LocalHomographies,
    shift: ComplexArray,
    grow: ComplexArray,
    anisotropy: ComplexArray,
    keystone: ComplexArray,
) -> LocalHomographies:
    """Return the homographies after a small step of each marker in its own coordinates.

    The step is `z ↦ shift + (1 + grow) z + anisotropy z̄ - z Re(q̄ z)`, with (N,) complex `shift`, `grow`
    (real part: scale, imaginary part: rotation), `anisotropy` and `keystone` q; the result is right to
    first order in each of them.
    """
    areas = np.abs(before.similarities) ** 2 - np.abs(before.anisotropies) ** 2
    perspective = (keystone * before.similarities - keystone.conj() * before.anisotropies) / areas
    return replace(
        before,
        centers=before.centers + before.similarities * shift + before.anisotropies * shift.conj(),
        similarities=before.similarities * (1 + grow) + before.anisotropies * anisotropy.conj(),
        anisotropies=before.anisotropies * (1 + grow.conj()) + before.similarities * anisotropy,
        perspectives=before.perspectives + perspective,
    )


def keystones_to(before: LocalHomographies, perspectives: ComplexArray) -> ComplexArray:
    """Return the keystones q (N,) of the steps of `moved` to `perspectives` (N,), 1/px.

    A change δ of the perspective is the keystone `δ m̄ + δ̄ k`, exactly.
    """
    return replace(before, perspectives=perspectives - before.perspectives).keystones()


def blur_anisotropies(homographies: LocalHomographies) -> ComplexArray:
    """Return by how much (N,) blur that is round in the image differs along a marker's directions.

    With e = k / m it is `a = e / (1 + |e|²)`: the blur's variances along x and y are those of
    `LocalHomographies.blurs` times `1 ∓ 2 Re a`, and its covariance is `-2 Im a` times as much.
    """
    relative = homographies.anisotropies / homographies.similarities
    return np.asarray(relative / (1 + np.abs(relative) ** 2))
