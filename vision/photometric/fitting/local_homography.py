"""The image of each marker as a local homography.

A marker's plane has coordinates z = right + i down, in marker sides, with the origin at the marker's centre.
The image of a point z is

    p(z) = p_0 + (m z + k z̄) / (1 + Re(h̄ (m z + k z̄))),

with four complex parameters: the centre p_0 = u + iv, px; the similarity m, px; the anisotropy k, px, by
which the affine image of the square differs from a square; and the perspective h, 1/px. The anisotropy in
image axes, `ε = k / m̄`, is the same however the marker is turned in the image. The markers of one plane are
compared by it (`plane`).
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import numpy.typing as npt

from skyherd.geometry import Array, ComplexArray, fit_squares, to_complex
from skyherd.vision.native.records import HOMOGRAPHY
from skyherd.vision.row_record import RowRecord

MIN_AREA_PX2 = 1e-9
"""Smallest area between diagonals that is divided by, px²; below it the corners are no quadrilateral."""


@dataclass(frozen=True)
class LocalHomographies(RowRecord):
    """Homographies from marker coordinates to the image, for N markers; the symbols are the module's.

    Attributes:
        centers: (N,) images p_0 of the markers' centres, px.
        similarities: (N,) similarity parts m, px.
        anisotropies: (N,) anisotropies k, px.
        perspectives: (N,) projective parts h, 1/px.
    """

    centers: ComplexArray
    similarities: ComplexArray
    anisotropies: ComplexArray
    perspectives: ComplexArray

    def __len__(self) -> int:
        return int(self.centers.size)

    @classmethod
    def of_corners(cls, corners_px: Array) -> "LocalHomographies":
        """Return the affine maps nearest to image corners (N, 4, 2): least squares, no perspective."""
        squares = fit_squares(to_complex(corners_px))
        perspectives = np.zeros(len(corners_px), dtype=complex)
        return cls(squares.centers, squares.similarities, squares.anisotropies, perspectives)

    @classmethod
    def of_quads(cls, corners_px: Array) -> "LocalHomographies":
        """Return the homographies that take the square to image corners (N, 4, 2) exactly.

        With `p = (J z) / (1 + g·z)` from the centre, g in marker coordinates, the perspective is `J⁻ᵀ g`.
        """
        corners = to_complex(corners_px)
        first, second, third, fourth = corners.T
        one, two = third - first, fourth - second
        area = (one.conj() * two).imag
        along = ((second - first).conj() * two).imag / np.where(np.abs(area) < MIN_AREA_PX2, np.inf, area)
        centers = first + along * one
        # Projective depths of the corners from their distances along the diagonals: 1 ± g·z at opposite ones.
        near, far = np.abs(centers - first), np.abs(third - centers)
        left, right = np.abs(centers - second), np.abs(fourth - centers)
        down, across = (far - near) / (far + near), (right - left) / (right + left)
        g_x, g_y = -(down - across), -(down + across)
        weights = np.stack([1 + (-g_x - g_y) / 2, 1 + (g_x - g_y) / 2], axis=1)
        to_first, to_second = (first - centers) * weights[:, 0], (second - centers) * weights[:, 1]
        right_axis, down_axis = to_second - to_first, -(to_first + to_second)
        similarities, anisotropies = (right_axis - 1j * down_axis) / 2, (right_axis + 1j * down_axis) / 2
        affine = cls(centers, similarities, anisotropies, np.zeros(len(corners), dtype=complex))
        x, y = affine.axes()
        return replace(affine, perspectives=np.asarray(x * g_x + y * g_y))

    @classmethod
    def of_records(cls, records: npt.NDArray[np.void]) -> "LocalHomographies":
        """Return the homographies of records (N,) of `HOMOGRAPHY`."""
        return cls(*(np.ascontiguousarray(records[name]) for name in HOMOGRAPHY.names or ()))

    def records(self) -> npt.NDArray[np.void]:
        """Return the homographies as records (N,) of `HOMOGRAPHY`."""
        records = np.empty(len(self), dtype=HOMOGRAPHY)
        for name in HOMOGRAPHY.names or ():
            records[name] = getattr(self, name)
        return records

    def keystones(self) -> ComplexArray:
        """Return the keystones q (N,): the marker's image shrinks by Re(q̄ z) towards its point z."""
        return np.asarray(
            self.perspectives * self.similarities.conj() + self.perspectives.conj() * self.anisotropies
        )

    def blurs(self, sigmas_px: float | Array) -> Array:
        """Return blurs (N,) of standard deviations `sigmas_px`, px, in marker sides.

        Blur that is round in the image has different variances along different directions of an anisotropic
        marker; this is the root of their mean, `σ sqrt(|m|² + |k|²) / (|m|² - |k|²)`.
        """
        mean_square = np.abs(self.similarities) ** 2 + np.abs(self.anisotropies) ** 2
        return np.asarray(sigmas_px * np.sqrt(mean_square) / np.abs(self._areas))

    def images(self, z: ComplexArray) -> ComplexArray:
        """Return the image points (N, M), u + iv, of points z (M,) of each marker's plane."""
        away = self.similarities[:, None] * z + self.anisotropies[:, None] * z.conj()
        return np.asarray(
            self.centers[:, None] + away / (1 + (self.perspectives.conj()[:, None] * away).real)
        )

    def scaled(self, factor: float) -> "LocalHomographies":
        """Return the homographies into an image shrunk by means over `factor` x `factor` pixels.

        Pixel centres have whole coordinates, so that the point p lies at `(p - (factor - 1) / 2 (1 + i)) /
        factor` in the shrunk image. A factor below 1 enlarges.
        """
        middle = (factor - 1) / 2 * (1 + 1j)
        return LocalHomographies(
            (self.centers - middle) / factor,
            self.similarities / factor,
            self.anisotropies / factor,
            self.perspectives * factor,
        )

    def sides_px(self) -> Array:
        """Return the (N,) sides, px: square roots of the areas of the markers' affine images."""
        return self._sides_px

    @cached_property
    def _sides_px(self) -> Array:
        return np.asarray(np.sqrt(np.abs(self._areas)))

    @cached_property
    def _areas(self) -> Array:
        """Return areas (N,) of the affine images, `|m|² - |k|²`, px²."""
        m, k = self.similarities, self.anisotropies
        return np.asarray(m.real**2 + m.imag**2 - (k.real**2 + k.imag**2))

    def headings_rad(self) -> Array:
        """Return the (N,) directions in the image of the forward axis z = -i, from +u to +v."""
        return np.angle(-1j * (self.similarities - self.anisotropies))

    def axes(self) -> tuple[ComplexArray, ComplexArray]:
        """Return the axes X and Y, each (N,), 1/px, that take image points back to marker coordinates.

        A point p, relative to the centre, is `z = (Re(X̄ p) + i Re(Ȳ p)) / (1 - Re(h̄ p))`.
        """
        return (self.similarities - self.anisotropies) / self._areas, 1j * (
            self.similarities + self.anisotropies
        ) / self._areas
