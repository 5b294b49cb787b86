"""Which robot an address means."""

import re
import time
from collections.abc import Callable
from typing import cast

from skyherd.errors import InputError, SkyherdError
from skyherd.live.drivers.driver import HOLD_S, RATE_HZ, RobotDriver
from skyherd.live.drivers.dry_run import DryRun
from skyherd.live.drivers.limits import LIMITS, SpeedLimits
from skyherd.live.drivers.lines import SerialLines, UdpLines
from skyherd.live.drivers.link import Link
from skyherd.live.drivers.mqtt import Mqtt
from skyherd.live.drivers.ros2 import Ros2
from skyherd.plugins import import_factory

PLUGIN = re.compile(r"[A-Za-z_][\w.]*:[A-Za-z_]\w*(=.*)?", re.DOTALL)
"""`module:factory`, perhaps with `=TEXT`."""

ALLOWED = "ros2://…, mqtt://…, serial:///dev/ttyUSB0, udp://host:port, dry-run, module:factory"
"""What an address may be, for complaints."""

FACTORY = "a function of (robot_id, text) that returns an object with write(motion) and close()"
"""What a plug-in has to be."""


def open_driver(
    address: str,
    *,
    robot_id: int,
    limits: SpeedLimits = LIMITS,
    rate_hz: float = RATE_HZ,
    hold_s: float = HOLD_S,
    clock: Callable[[], float] = time.monotonic,
) -> RobotDriver:
    """Open the driver of one robot; close what is returned, which stops the robot.

    | address | what it is |
    |---|---|
    | `ros2://host/robot3/cmd_vel?type=TwistStamped&domain=0` | ROS 2 over Zenoh (`ros2`) |
    | `mqtt://user:password@host/topic`, `mqtts://…` | JSON to a broker of MQTT (`mqtt`) |
    | `serial:///dev/ttyUSB0?baud=115200` | lines of text over a serial port (`lines`) |
    | `udp://host:9000` | the same lines, a packet each |
    | `dry-run` | prints what the robot would do |
    | `module:factory`, `module:factory=TEXT` | a link of one's own |

    Args:
        address: see above; `{id}` in it stands for the robot's number.
        robot_id: the robot.
        limits: on speed, turn and acceleration.
        rate_hz: how often something is written.
        hold_s: age at which a command is forgotten and zero is sent.
        clock: gives the time, s.

    Raises:
        InputError: it cannot be opened; one clear line, without a password that the address may contain.
    """
    link = _link_of(address, robot_id)
    return RobotDriver(link, robot_id=robot_id, limits=limits, rate_hz=rate_hz, hold_s=hold_s, clock=clock)


def _link_of(address: str, robot_id: int) -> Link:
    """The link that an address means."""
    address = address.replace("{id}", str(robot_id))
    if address == "dry-run":
        return DryRun(robot_id)
    scheme = address.partition("://")[0].lower() if "://" in address else ""
    if scheme in _LINKS:
        try:
            return _LINKS[scheme](address, robot_id)
        except ValueError as error:
            if isinstance(error, InputError):
                raise
            shown = re.sub("//[^/]*@", "//", address)
            raise InputError(f"driver {shown}", str(error), ALLOWED) from None
    if PLUGIN.fullmatch(address):
        return _plugin(address, robot_id)
    raise InputError("driver", f"no driver {address!r}", ALLOWED)


_LINKS: dict[str, Callable[[str, int], Link]] = {
    "mqtt": Mqtt,
    "mqtts": Mqtt,
    "ros2": Ros2,
    "serial": SerialLines,
    "udp": UdpLines,
}
"""What opens a link, by the scheme of its address."""


def _plugin(address: str, robot_id: int) -> Link:
    """What a factory of one's own makes."""
    name, _, text = address.partition("=")
    where = f"driver {name}"
    factory = import_factory(name, where, FACTORY)
    try:
        link = factory(robot_id, text)
    except SkyherdError:
        raise
    except Exception as error:
        raise InputError(where, f"{type(error).__name__}: {error}", FACTORY) from error
    if not callable(getattr(link, "write", None)) or not callable(getattr(link, "close", None)):
        raise InputError(where, f"the factory returned {type(link).__name__}", FACTORY)
    if not hasattr(link, "name"):
        link.name = where
    return cast(Link, link)
