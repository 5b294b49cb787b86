"""Shutter, and velocities of camera and robots during an exposure.

Motion blur is the mean of sharp images over the exposure. With a rolling shutter each image row has its own
time. `docs/sensor.png` shows each part of camera and sensor.
"""

from dataclasses import dataclass, replace

import numpy as np

from skyherd.geometry import Array
from skyherd.render.camera.camera import CameraPose


@dataclass(frozen=True)
class Shutter:
    """Exposure time and row time; with zeros all rows are exposed at the same instant.

    Row v is exposed for `exposure_s` around the time `row_time_s (v - (height - 1) / 2)`. The pose of a shot
    is that of the middle row in the middle of its exposure.

    Attributes:
        exposure_s: exposure time of each row.
        row_time_s: time from one row to the next.
    """

    exposure_s: float = 0.0
    row_time_s: float = 0.0


@dataclass(frozen=True, eq=False)
class Motion:
    """Velocities of camera and robots, constant during an image.

    Attributes:
        camera_mps: velocity of the camera along x, y and up.
        yaw_rate_radps: yaw rate of the camera, counter-clockwise from above.
        robots_mps: (N, 2) velocities of the robots; None if at rest.
        robots_radps: (N,) turn rates of the robots; None if 0.
        tilt_rates_radps: rates of the camera's two tilts.
    """

    camera_mps: tuple[float, float, float] = (0.0, 0.0, 0.0)
    yaw_rate_radps: float = 0.0
    robots_mps: Array | None = None
    robots_radps: Array | None = None
    tilt_rates_radps: tuple[float, float] = (0.0, 0.0)

    @property
    def still(self) -> bool:
        """True if all velocities are zero or None."""
        robots = (rates for rates in (self.robots_mps, self.robots_radps) if rates is not None)
        camera = (*self.camera_mps, self.yaw_rate_radps, *self.tilt_rates_radps)
        return not (any(camera) or any(np.any(rates) for rates in robots))

    def pose_at(self, pose: CameraPose, time_s: float) -> CameraPose:
        """Return the camera's pose `time_s` after the instant of `pose`; before it if negative."""
        vx, vy, climb = self.camera_mps
        by_u, by_v = self.tilt_rates_radps
        return replace(
            pose,
            position_m=(pose.position_m[0] + vx * time_s, pose.position_m[1] + vy * time_s),
            height_m=pose.height_m + climb * time_s,
            yaw_rad=pose.yaw_rad + self.yaw_rate_radps * time_s,
            tilt_rad=(pose.tilt_rad[0] + by_u * time_s, pose.tilt_rad[1] + by_v * time_s),
        )

    def robots_at(self, positions_m: Array, headings_rad: Array, time_s: float) -> tuple[Array, Array]:
        """Return positions (N, 2), m, and headings (N,), rad, `time_s` after the instant of the arguments."""
        if self.robots_mps is not None:
            positions_m = positions_m + np.asarray(self.robots_mps) * time_s
        if self.robots_radps is not None:
            headings_rad = headings_rad + np.asarray(self.robots_radps) * time_s
        return positions_m, headings_rad


STILL = Motion()
"""Camera and robots at rest."""

INSTANT = Shutter()
"""Instantaneous global shutter."""
