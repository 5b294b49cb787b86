"""Motion during an exposure: the shutter, and the velocities of camera and robots.

Motion blur is the mean of sharp images over the exposure. A rolling shutter gives each image row an instant
of its own. Both hold for robots and cameras alike: `Motion` moves them, and `skyherd.render.view` asks it for
the instant of each row. `docs/sensor.png` shows every part of camera and sensor.
"""

from dataclasses import dataclass, replace

import numpy as np

from skyherd.geometry import Array
from skyherd.render.camera.camera import CameraPose


@dataclass(frozen=True)
class Shutter:
    """Exposure of each row; with zeros all rows see one instant.

    Row v gathers light for `exposure_s` around the time `row_time_s (v - (height - 1) / 2)`: the pose given
    is the middle row's in the middle of its exposure.

    Attributes:
        exposure_s: for how long each row gathers light.
        row_time_s: time from one row to the next.
    """

    exposure_s: float = 0.0
    row_time_s: float = 0.0


@dataclass(frozen=True, eq=False)
class Motion:
    """Velocities of camera and robots, constant over the time that an image takes.

    Attributes:
        camera_mps: of the camera, ground axes x, y, and up.
        yaw_rate_radps: of the camera, counter-clockwise from above.
        robots_mps: (N, 2) of the robots; at rest if None.
        robots_radps: (N,) their turn rates; none if None.
        tilt_rates_radps: of the camera, by how much its tilts change.
    """

    camera_mps: tuple[float, float, float] = (0.0, 0.0, 0.0)
    yaw_rate_radps: float = 0.0
    robots_mps: Array | None = None
    robots_radps: Array | None = None
    tilt_rates_radps: tuple[float, float] = (0.0, 0.0)

    @property
    def still(self) -> bool:
        """Return whether nothing moves: all velocities are zero or not given."""
        robots = (rates for rates in (self.robots_mps, self.robots_radps) if rates is not None)
        camera = (*self.camera_mps, self.yaw_rate_radps, *self.tilt_rates_radps)
        return not (any(camera) or any(np.any(rates) for rates in robots))

    def pose_at(self, pose: CameraPose, time_s: float) -> CameraPose:
        """Return the camera's pose `time_s` after the instant of `pose`; earlier if negative."""
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
        """Positions (N, 2), m, and headings (N,), rad, `time_s` after the instant of those given."""
        if self.robots_mps is not None:
            positions_m = positions_m + np.asarray(self.robots_mps) * time_s
        if self.robots_radps is not None:
            headings_rad = headings_rad + np.asarray(self.robots_radps) * time_s
        return positions_m, headings_rad


STILL = Motion()
"""Nothing moves."""

INSTANT = Shutter()
"""All rows see the same instant, without blur."""
