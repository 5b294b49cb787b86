"""Sway of a hovering unit's camera: a random tilt with a given spectrum, as a sum of waves.

The tilt about each of the camera's two axes is a stationary process of standard deviation σ. It is Gaussian
up to the finite number M of waves. Its power spectrum is a bell around f₀ = 1 / period of width f₀ / 4:

    a(t) = σ sqrt(2 / M) Σ_m cos(2π f_m t + φ_m),      f_m ~ N(f₀, (f₀ / 4)²),   φ_m uniform.

The autocorrelation is `σ² exp(-(2π f₀ τ / 4)² / 2) cos(2π f₀ τ)` (Shinozuka and Deodatis 1991, with random
frequencies). The tilt is a function of time alone and independent of the step size. Its rate, which motion
blur and rolling shutter need, is exact.
"""

from dataclasses import dataclass

import numpy as np

from skyherd.geometry import Array

WAVES = 64
"""Number M of waves. Derived: the kurtosis of the sum is 3 - 1.5 / M, 2.98 instead of the 3 of a Gaussian."""

BANDWIDTH = 0.25
"""Standard deviation of the waves' frequencies, as a share of the mean frequency. Chosen: the autocorrelation
of the tilt after one period is then 0.29; at twice the value it is 0.01, at half 0.73."""


@dataclass(frozen=True, eq=False)
class Sway:
    """Tilts about a camera's u and v axes as functions of time.

    Attributes:
        amplitude_rad: amplitude of each wave, `σ sqrt(2 / M)`.
        rates_radps: (2, M) angular frequencies `2π f_m` of the waves, by axis.
        phases_rad: (2, M) phases φ_m.
    """

    amplitude_rad: float
    rates_radps: Array
    phases_rad: Array

    @classmethod
    def draw(cls, tilt_rad: float, period_s: float, rng: np.random.Generator) -> "Sway":
        """Draw a sway.

        Args:
            tilt_rad: root mean square of the tilt of both axes together, `sqrt(2) σ`.
            period_s: period 1 / f₀.
            rng: generator of frequencies and phases.
        """
        middle = 2 * np.pi / period_s
        rates = middle * (1 + BANDWIDTH * rng.standard_normal((2, WAVES)))
        return cls(tilt_rad / np.sqrt(WAVES), rates, rng.uniform(-np.pi, np.pi, (2, WAVES)))

    def tilts_rad(self, time_s: float) -> Array:
        """Return the tilts (2,), rad, about the u and v axes at a time."""
        waves = np.cos(self.rates_radps * time_s + self.phases_rad)
        return np.asarray(self.amplitude_rad * waves.sum(axis=1))

    def rates_at(self, time_s: float) -> Array:
        """Return the rates of change (2,), rad/s, of the tilts at a time."""
        slopes = -np.sin(self.rates_radps * time_s + self.phases_rad)
        return np.asarray(self.amplitude_rad * (self.rates_radps * slopes).sum(axis=1))
