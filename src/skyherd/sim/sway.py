"""How a unit's camera sways: filtered noise, as a sum of waves.

The tilt about each of the camera's axes is a stationary Gaussian process, but for the finite number of waves,
of standard deviation σ and with a power spectrum that is a bell around f₀ = 1 / period, f₀ / 4 wide:

    a(t) = σ sqrt(2 / M) Σ_m cos(2π f_m t + φ_m),      f_m ~ N(f₀, (f₀ / 4)²),   φ_m uniform,

so that its autocorrelation is `σ² exp(-(2π f₀ τ / 4)² / 2) cos(2π f₀ τ)` (Shinozuka and Deodatis 1991, with
random frequencies). It is a function of time alone: no step size enters, and its slope is exact.
"""

from dataclasses import dataclass

import numpy as np

from skyherd.geometry import Array

WAVES = 64
"""M: the kurtosis is 3 - 1.5 / M."""

BANDWIDTH = 0.25
"""Width of the bell, in its middle frequency."""


@dataclass(frozen=True, eq=False)
class Sway:
    """Tilts about a camera's u and v axes over time.

    Attributes:
        amplitude_rad: of each wave.
        rates_radps: (2, M) their angular frequencies.
        phases_rad: (2, M).
    """

    amplitude_rad: float
    rates_radps: Array
    phases_rad: Array

    @classmethod
    def draw(cls, tilt_rad: float, period_s: float, rng: np.random.Generator) -> "Sway":
        """Waves from `rng`; `tilt_rad` is the root mean square of the tilt, of both axes together."""
        middle = 2 * np.pi / period_s
        rates = middle * (1 + BANDWIDTH * rng.standard_normal((2, WAVES)))
        return cls(tilt_rad / np.sqrt(WAVES), rates, rng.uniform(-np.pi, np.pi, (2, WAVES)))

    def tilts_rad(self, time_s: float) -> Array:
        """(2,) tilts at an instant."""
        waves = np.cos(self.rates_radps * time_s + self.phases_rad)
        return np.asarray(self.amplitude_rad * waves.sum(axis=1))

    def rates_at(self, time_s: float) -> Array:
        """(2,) rad/s by which they change."""
        slopes = -np.sin(self.rates_radps * time_s + self.phases_rad)
        return np.asarray(self.amplitude_rad * (self.rates_radps * slopes).sum(axis=1))
