"""Commands to motors: speeds of the ground robots, and flight velocities of the aerial units."""

from dataclasses import dataclass

import numpy as np

from skyherd.geometry import Array, IntArray
from skyherd.messages.checks import check_numbers
from skyherd.messages.frozen_arrays import freeze, freeze_ids
from skyherd.messages.short_repr import short_repr


@dataclass(frozen=True)
class VelocityCommand:
    """Speeds of all robots of the team until the next command, as arrays over robots.

    Attributes:
        ids: (N,) robots, each once.
        v_mps: (N,) forward speeds of the wheel axes; negative is backwards.
        omega_radps: (N,) turn rates, counter-clockwise seen from above.
    """

    ids: IntArray
    v_mps: Array
    omega_radps: Array

    __repr__ = short_repr

    def __post_init__(self) -> None:
        n = freeze_ids(self, "ids")
        freeze(self, "v_mps", (n,))
        freeze(self, "omega_radps", (n,))


@dataclass(frozen=True)
class FlightCommand:
    """Velocity command of one aerial unit to its own autopilot, in the frame of its camera.

    Attributes:
        unit_id: the unit.
        lateral_mps: (2,) horizontal velocity along the image's +u and +v.
        climb_mps: vertical velocity, positive upwards.
        yaw_rate_radps: turn rate, counter-clockwise seen from above.
        zoom_rate_ps: relative change of the focal length, 1/s.
    """

    unit_id: int
    lateral_mps: Array
    climb_mps: float
    yaw_rate_radps: float
    zoom_rate_ps: float = 0.0

    @classmethod
    def hold(cls, unit_id: int, yaw_rate_radps: float = 0.0) -> "FlightCommand":
        """Return the command to stay in place, with a constant turn rate if requested."""
        return cls(unit_id, np.zeros(2), climb_mps=0.0, yaw_rate_radps=yaw_rate_radps)

    def __post_init__(self) -> None:
        freeze(self, "lateral_mps", (2,))
        check_numbers(self, finite=("climb_mps", "yaw_rate_radps", "zoom_rate_ps"))
