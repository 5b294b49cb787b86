"""Drivers: velocity commands to robots by ROS 2, MQTT, serial and UDP lines, or printed.

Start with `open_driver`. docs/live/drivers.md has the addresses and the wire formats.
"""

from skyherd.live.drivers.addresses import DRY_RUN, WORLD, check_driver, open_driver
from skyherd.live.drivers.driver import HOLD_S, RATE_HZ, RobotDriver
from skyherd.live.drivers.limits import LIMITS, Limiter, SpeedLimits
from skyherd.live.drivers.link import STILL, Link, Motion

__all__ = [
    "DRY_RUN",
    "HOLD_S",
    "LIMITS",
    "RATE_HZ",
    "STILL",
    "WORLD",
    "Limiter",
    "Link",
    "Motion",
    "RobotDriver",
    "SpeedLimits",
    "check_driver",
    "open_driver",
]
