"""Drives of the robots: from commanded (v, ω) to the actual motion of wheels and body."""

from collections import deque
from dataclasses import dataclass

import numpy as np

from skyherd.geometry import Array
from skyherd.messages import VelocityCommand

SLIP_TIME_S = 0.5
"""Correlation time of slip, s. Chosen: longer than a time step, so that slip does not average out within a
few steps, and shorter than a run. Twice the value increases the final position error by a factor of 1.4."""

STEP_TOLERANCE = 1e-9
"""Tolerance of a delay above a whole number of steps, in steps. Derived: above the rounding of the quotient
of 60 s, the maximum delay, and a step of 1e-4 s (6e5 x 2^-53 = 7e-11)."""


@dataclass(frozen=True)
class DriveParameters:
    """Parameters of the drives of all robots. Each effect is off by default, as in the paper.

    Attributes:
        max_speed_mps: limit of |v| of a command.
        max_turn_radps: limit of |ω| of a command.
        max_accel_mps2: limit of |dv/dt|.
        max_turn_accel_radps2: limit of |dω/dt|.
        wheel_step_mps: quantisation step of wheel speeds; 0 for none.
        dead_zone_mps: magnitude below which a wheel speed becomes 0.
        gain_error: maximum relative error of a wheel's speed.
        track_m: distance between the two wheels, for the three preceding effects.
        slip: standard deviation of the relative error of v and ω on the ground.
        delay_s: time from a command to its effect, rounded up to whole steps.
        axis_offset_m: distance of the body's centre and the marker ahead of the wheel axis.
    """

    max_speed_mps: float = np.inf
    max_turn_radps: float = np.inf
    max_accel_mps2: float = np.inf
    max_turn_accel_radps2: float = np.inf
    wheel_step_mps: float = 0.0
    dead_zone_mps: float = 0.0
    gain_error: float = 0.0
    track_m: float = 0.2
    slip: float = 0.0
    delay_s: float = 0.0
    axis_offset_m: float = 0.0

    @property
    def has_wheels(self) -> bool:
        """True if an effect acts on single wheels."""
        return bool(self.wheel_step_mps or self.dead_zone_mps or self.gain_error)


def wheel_speeds(v_mps: Array, omega_radps: Array, track_m: float) -> Array:
    """Return the speeds (2, N), m/s, of the left and the right wheels: `v -+ ω track / 2`."""
    half_difference = omega_radps * (track_m / 2)
    return np.stack([v_mps - half_difference, v_mps + half_difference])


def body_rates(wheels_mps: Array, track_m: float) -> tuple[Array, Array]:
    """Return v (N,), m/s, and ω (N,), rad/s, of bodies from the speeds (2, N) of their wheels.

    v is the mean of both wheels, and ω their difference over the track: the inverse of `wheel_speeds`.
    """
    left, right = wheels_mps
    return (left + right) / 2, (right - left) / track_m


class Drive:
    """Drives of N robots, advanced one time step at a time.

    A command passes the following effects in this order. Each is one key of `DriveParameters` and is off by
    default, which leaves the command unchanged to the bit. The order keeps the limits of earlier effects
    intact. Slip is last, because it belongs to the ground.

    - delay: the robot obeys the command of `ceil(delay_s / dt)` steps ago, and rests before its first;
    - dead zone: wheel speeds of less than `dead_zone_mps` are zero;
    - quantisation: wheel speeds are rounded to the nearest multiples of `wheel_step_mps`;
    - gain: each wheel turns `1 + e` times as fast, with e uniform within `gain_error`, drawn once;
    - acceleration: v and ω change by at most `max_accel_mps2 dt` and `max_turn_accel_radps2 dt`;
    - slip: the body moves at `(1 + s) v` and `(1 + r) ω`, with independent first-order noise s and r of
      standard deviation `slip` and correlation time `SLIP_TIME_S`.

    Attributes:
        gains: (2, N) factors 1 + e of the left and the right wheels.

    Args:
        parameters: parameters of all robots.
        count: number N of robots.
        step_s: the time step dt.
        gain_rng: generator of the wheels' gains.
        slip_rng: generator of slip.
    """

    def __init__(
        self,
        parameters: DriveParameters,
        count: int,
        *,
        step_s: float,
        gain_rng: np.random.Generator,
        slip_rng: np.random.Generator,
    ) -> None:
        self.parameters, self._step_s = parameters, step_s
        late = max(0, int(np.ceil(parameters.delay_s / step_s - STEP_TOLERANCE)))
        at_rest = np.zeros((2, count))
        self._commands = deque([at_rest] * late, maxlen=late + 1)
        self._rates = at_rest
        error = parameters.gain_error
        self.gains = 1 + gain_rng.uniform(-error, error, (2, count))
        self._slip_rng = slip_rng
        self._slip: Array | None = None

    def limit(self, command: VelocityCommand) -> VelocityCommand:
        """Return the command with |v| and |ω| clipped to their limits, as the robots accept it."""
        most = self.parameters
        return VelocityCommand(
            command.ids,
            np.clip(command.v_mps, -most.max_speed_mps, most.max_speed_mps),
            np.clip(command.omega_radps, -most.max_turn_radps, most.max_turn_radps),
        )

    def step(self, command: VelocityCommand) -> tuple[Array, Array]:
        """Advance one time step; return v (N,), m/s, of the wheel axes and ω (N,), rad/s, in it.

        Args:
            command: command of all N robots in order, within the limits.
        """
        self._commands.append(np.stack([command.v_mps, command.omega_radps]))
        commanded = self._commands[0]
        if self.parameters.has_wheels:
            commanded = np.stack(self._through_wheels(commanded))
        self._rates = self._accelerated(commanded)
        v_mps, omega_radps = self._slipping(self._rates)
        return v_mps, omega_radps

    def _through_wheels(self, rates: Array) -> tuple[Array, Array]:
        parameters = self.parameters
        wheels = wheel_speeds(rates[0], rates[1], parameters.track_m)
        wheels = np.where(np.abs(wheels) < parameters.dead_zone_mps, 0.0, wheels)
        if parameters.wheel_step_mps:
            wheels = np.rint(wheels / parameters.wheel_step_mps) * parameters.wheel_step_mps
        return body_rates(wheels * self.gains, parameters.track_m)

    def _accelerated(self, commanded: Array) -> Array:
        limits = np.array([self.parameters.max_accel_mps2, self.parameters.max_turn_accel_radps2])
        if np.isinf(limits).all():
            return commanded
        most = limits[:, None] * self._step_s
        change = commanded - self._rates
        return np.where(np.abs(change) <= most, commanded, self._rates + np.copysign(most, change))

    def _slipping(self, rates: Array) -> Array:
        if not self.parameters.slip:
            return rates
        noise = self.parameters.slip * self._slip_rng.standard_normal(rates.shape)
        # First-order noise, stationary from the start: s' = ρ s + sqrt(1 - ρ²) slip n, n standard normal.
        # The time constant makes the final position nearly independent of the step.
        rho = np.exp(-self._step_s / SLIP_TIME_S)
        self._slip = noise if self._slip is None else rho * self._slip + np.sqrt(1 - rho**2) * noise
        return np.asarray(rates * (1 + self._slip))
