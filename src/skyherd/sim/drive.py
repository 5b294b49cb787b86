"""Robots as they are: from the commanded (v, omega) to what the wheels do with it."""

from collections import deque

import numpy as np

from skyherd.datasets import DriveModel, RobotsModel
from skyherd.geometry import Array
from skyherd.messages import VelocityCommand
from skyherd.random_streams import RunStream, generator

SLIP_TIME_S = 0.5
"""Time over which slip forgets itself."""


def limit(command: VelocityCommand, robots: RobotsModel) -> VelocityCommand:
    """The command as a robot takes it: |v| and |omega| within their limits."""
    return VelocityCommand(
        command.ids,
        np.clip(command.v_mps, -robots.max_speed_mps, robots.max_speed_mps),
        np.clip(command.omega_radps, -robots.max_turn_radps, robots.max_turn_radps),
    )


def wheel_speeds(v_mps: Array, omega_radps: Array, track_m: float) -> Array:
    """Speeds (2, N) of the left and the right wheel: `v -+ omega track / 2`."""
    turn = omega_radps * (track_m / 2)
    return np.stack([v_mps - turn, v_mps + turn])


def body_rates(wheels_mps: Array, track_m: float) -> tuple[Array, Array]:
    """Speed (N,) and turn rate (N,) of a body by its wheels (2, N): mean, and difference over the track."""
    left, right = wheels_mps
    return (left + right) / 2, (right - left) / track_m


class Drive:
    """What N robots do with their commands, one step after the other.

    A command goes through these, in this order, each by one key of `DriveModel` and off without it:

    - delay: the robot obeys the command of `ceil(delay_s / step_s)` steps ago, and rests before its first;
    - dead zone: wheel speeds of less than `dead_zone_mps` are zero;
    - quantisation: wheel speeds are the nearest multiples of `wheel_step_mps`, off by half a step at most;
    - gain: each wheel turns `1 + e` times as fast, e uniform within `gain_error`, once for all;
    - acceleration: v and omega go towards that by at most `max_accel_mps2 dt` and
      `max_turn_accel_radps2 dt` a step, so that no later part breaks these limits, and a stop is a stop;
    - slip: the body moves at `(1 + s) v` and `(1 + r) omega`. s and r are independent first-order noise of
      standard deviation `slip` from the start on, `s' = rho s + sqrt(1 - rho²) slip n`, n standard normal,
      `rho = exp(-dt / SLIP_TIME_S)`: where a robot ends then hardly depends on the step.

    Args:
        model: which parts there are.
        count: N.
        step_s: dt.
        seed: the scenario's.
    """

    def __init__(self, model: DriveModel, count: int, step_s: float, seed: int) -> None:
        self.model, self._step_s = model, step_s
        late = max(0, int(np.ceil(model.delay_s / step_s - 1e-9)))
        at_rest = np.zeros((2, count))
        self._commands = deque([at_rest] * late, maxlen=late + 1)
        self._rates = at_rest
        error = model.gain_error
        self.gains = 1 + generator(seed, RunStream.WHEEL_GAINS).uniform(-error, error, (2, count))
        self._slip_rng = generator(seed, RunStream.WHEEL_SLIP)
        self._slip: Array | None = None

    def step(self, command: VelocityCommand) -> tuple[Array, Array]:
        """Speed (N,) of the wheel axis and turn rate (N,) in the next step, given a command within limits."""
        self._commands.append(np.stack([command.v_mps, command.omega_radps]))
        asked = self._commands[0]
        if self.model.has_wheels:
            asked = np.stack(self._through_wheels(asked))
        self._rates = self._ramp(asked)
        v_mps, omega_radps = self._slipping(self._rates)
        return v_mps, omega_radps

    def _through_wheels(self, rates: Array) -> tuple[Array, Array]:
        model = self.model
        wheels = wheel_speeds(rates[0], rates[1], model.track_m)
        wheels = np.where(np.abs(wheels) < model.dead_zone_mps, 0.0, wheels)
        if model.wheel_step_mps:
            wheels = np.rint(wheels / model.wheel_step_mps) * model.wheel_step_mps
        return body_rates(wheels * self.gains, model.track_m)

    def _ramp(self, asked: Array) -> Array:
        limits = np.array([self.model.max_accel_mps2 or np.inf, self.model.max_turn_accel_radps2 or np.inf])
        if np.isinf(limits).all():
            return asked
        most = limits[:, None] * self._step_s
        return np.where(
            np.abs(asked - self._rates) <= most, asked, self._rates + np.copysign(most, asked - self._rates)
        )

    def _slipping(self, rates: Array) -> Array:
        if not self.model.slip:
            return rates
        noise = self.model.slip * self._slip_rng.standard_normal(rates.shape)
        rho = np.exp(-self._step_s / SLIP_TIME_S)
        self._slip = noise if self._slip is None else rho * self._slip + np.sqrt(1 - rho**2) * noise
        return np.asarray(rates * (1 + self._slip))
