"""How markers lie in an image: a local homography each.

A marker's plane has coordinates z = right + i down, in marker sides from its centre. Its image is

    p(z) = p_0 + (m z + k z̄) / (1 + Re(h̄ (m z + k z̄))),

with the centre p_0 = u + iv, the arm m that a similarity would have, the squeeze k by which the image differs
from one, and the horizon h, all complex. The squeeze in image axes, `ε = k / m̄`, does not depend on how the
marker is turned.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from skyherd.geometry import Array, ComplexArray, fit_squares, to_complex
from skyherd.vision.row_record import Rows


@dataclass(frozen=True)
class Shapes(Rows):
    """Images of N markers.

    Attributes:
        centers: (N,) p_0, px.
        arms: (N,) m, px.
        squeezes: (N,) k, px.
        horizons: (N,) h, 1/px.
    """

    centers: ComplexArray
    arms: ComplexArray
    squeezes: ComplexArray
    horizons: ComplexArray

    def __len__(self) -> int:
        return int(self.centers.size)

    @classmethod
    def of_corners(cls, corners_px: Array) -> "Shapes":
        """Least-squares affine shapes of corners (N, 4, 2)."""
        squares = fit_squares(to_complex(corners_px))
        horizons = np.zeros(len(corners_px), dtype=complex)
        return cls(squares.centers, squares.arms, squares.squeezes, horizons)

    def moved(self, shift: ComplexArray, grow: ComplexArray, squeeze: ComplexArray) -> "Shapes":
        """After `z ↦ shift + (1 + grow) z + squeeze z̄` in marker coordinates, to first order in each."""
        return replace(
            self,
            centers=self.centers + self.arms * shift + self.squeezes * shift.conj(),
            arms=self.arms * (1 + grow) + self.squeezes * squeeze.conj(),
            squeezes=self.squeezes * (1 + grow.conj()) + self.arms * squeeze,
        )

    def images(self, z: ComplexArray) -> ComplexArray:
        """Images (N, M) of points (M,) of the marker's plane."""
        away = self.arms[:, None] * z + self.squeezes[:, None] * z.conj()
        return np.asarray(self.centers[:, None] + away / (1 + (self.horizons.conj()[:, None] * away).real))

    def scaled(self, factor: float) -> "Shapes":
        """In an image shrunk by `factor`: pixel p is at `(p - (factor - 1) / 2) / factor` of it."""
        middle = (factor - 1) / 2 * (1 + 1j)
        return Shapes(
            (self.centers - middle) / factor,
            self.arms / factor,
            self.squeezes / factor,
            self.horizons * factor,
        )

    def sides_px(self) -> Array:
        """Square roots of the areas of the markers' affine images: local scale, px a side."""
        return self._sides_px

    @cached_property
    def _sides_px(self) -> Array:
        return np.asarray(np.sqrt(np.abs(self._areas)))

    @cached_property
    def _areas(self) -> Array:
        """`|m|² - |k|²`, px²."""
        m, k = self.arms, self.squeezes
        return np.asarray(m.real**2 + m.imag**2 - (k.real**2 + k.imag**2))

    def headings_rad(self) -> Array:
        """Directions of forward, z = -i."""
        return np.angle(-1j * (self.arms - self.squeezes))

    def axes(self) -> tuple[ComplexArray, ComplexArray]:
        """X and Y (N,), 1/px: a point p from the centre is `z = (Re(X̄ p) + i Re(Ȳ p)) / (1 - Re(h̄ p))`."""
        return (self.arms - self.squeezes) / self._areas, 1j * (self.arms + self.squeezes) / self._areas
