"""Addresses of robots."""

import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, cast

from skyherd.errors import InputError, SkyherdError
from skyherd.live.drivers.driver import HOLD_S, RATE_HZ, RobotDriver
from skyherd.live.drivers.dry_run import DryRun
from skyherd.live.drivers.limits import LIMITS, SpeedLimits
from skyherd.live.drivers.lines import SerialLines, UdpLines, serial_place, udp_place
from skyherd.live.drivers.link import Link
from skyherd.live.drivers.mqtt import Mqtt, broker_of
from skyherd.live.drivers.ros2 import Ros2, topic_of
from skyherd.live.live_clock import steady_s
from skyherd.plugins import import_factory

PLUGIN = re.compile(r"[A-Za-z_][\w.]*:[A-Za-z_]\w*(=.*)?", re.DOTALL)
"""`module:factory`, optionally with `=TEXT`."""

ALLOWED = "ros2://…, mqtt://…, serial:///dev/ttyUSB0, udp://host:port, dry-run, module:factory"
"""Allowed addresses, for error messages."""

DRY_RUN = "dry-run"
"""Address of the driver that only prints commands."""

WORLD = "world"
"""Address of wheels and autopilots simulated by `skyherd world`. `open_driver` refuses it: the processes of a
lab open it with their radio."""

FACTORY = "a function of (robot_id, text) that returns an object with write(motion) and close()"
"""Required signature of a plug-in, for error messages."""


def open_driver(
    address: str,
    *,
    robot_id: int,
    limits: SpeedLimits = LIMITS,
    flies: bool = False,
    rate_hz: float = RATE_HZ,
    hold_s: float = HOLD_S,
    clock: Callable[[], float] = steady_s,
) -> RobotDriver:
    """Open and return the driver of one robot. The caller closes it, which stops the robot.

    | address | link |
    |---|---|
    | `ros2://host/robot3/cmd_vel?type=TwistStamped&domain=0` | ROS 2 over Zenoh (`ros2`) |
    | `mqtt://user:password@host/topic`, `mqtts://…` | JSON to an MQTT broker (`mqtt`) |
    | `serial:///dev/ttyUSB0?baud=115200` | lines of text over a serial port (`lines`) |
    | `udp://host:9000` | the same lines, one per packet |
    | `dry-run` | prints the commands |
    | `module:factory`, `module:factory=TEXT` | a custom link |

    Args:
        address: see above; the robot's number replaces `{id}`.
        robot_id: the robot.
        limits: limits of speed, turn rate and acceleration.
        flies: True for a flying unit.
        rate_hz: rate at which commands are written.
        hold_s: watchdog time; commands of this age are stale, and zero is sent.
        clock: returns the time, s.

    Raises:
        InputError: the driver cannot be opened. The error text contains no password of the address.
    """
    link = _link_of(address, robot_id)
    return RobotDriver(
        link, robot_id=robot_id, limits=limits, flies=flies, rate_hz=rate_hz, hold_s=hold_s, clock=clock
    )


def check_driver(address: str, robot_id: int, *, imports: bool = False) -> None:
    """Refuse an invalid address of a robot in a lab. It opens nothing.

    Args:
        address: see `open_driver`, or `WORLD`.
        robot_id: the robot.
        imports: also import the factory of a custom driver, which then must exist on this machine.

    Raises:
        InputError: the scheme is unknown, or the host, port, speed, topic or an option is invalid.
    """
    address = address.replace("{id}", str(robot_id))
    if address in (DRY_RUN, WORLD):
        return
    transport = _transport_of(address, f"{ALLOWED}, {WORLD}")
    if transport is not None:
        with _one_line(address):
            transport.parse(address, robot_id)
    elif imports:
        _factory_of(address)


def _link_of(address: str, robot_id: int) -> Link:
    """Return the link of an address."""
    address = address.replace("{id}", str(robot_id))
    if address == DRY_RUN:
        return DryRun(robot_id)
    transport = _transport_of(address, ALLOWED)
    if transport is None:
        return _plugin(address, robot_id)
    with _one_line(address):
        return transport.open(address, robot_id)


@dataclass(frozen=True)
class Transport:
    """Functions for the links of one scheme.

    Attributes:
        parse: parses an address, and raises ValueError if it is invalid.
        open: opens the link of an address.
    """

    parse: Callable[[str, int], object]
    open: Callable[[str, int], Link]


_TRANSPORTS = {
    "mqtt": Transport(broker_of, Mqtt),
    "mqtts": Transport(broker_of, Mqtt),
    "ros2": Transport(topic_of, Ros2),
    "serial": Transport(serial_place, SerialLines),
    "udp": Transport(udp_place, UdpLines),
}
"""Transports by the scheme of an address."""


def _transport_of(address: str, allowed: str) -> Transport | None:
    """Return the transport of an address, or None for a custom factory."""
    scheme = address.partition("://")[0].lower() if "://" in address else ""
    if scheme not in _TRANSPORTS and not PLUGIN.fullmatch(address):
        raise InputError("driver", f"no driver {_shown(address)!r}", allowed)
    return _TRANSPORTS.get(scheme)


@contextmanager
def _one_line(address: str) -> Iterator[None]:
    """Raise ValueErrors of the body as InputError, without the password of the address."""
    try:
        yield
    except InputError:
        raise
    except ValueError as error:
        raise InputError(f"driver {_shown(address)}", str(error), ALLOWED) from None


def _shown(address: str) -> str:
    """Return an address without user and password."""
    return re.sub("//[^/]*@", "//", address)


def _factory_of(address: str) -> Callable[..., object]:
    """Return the custom factory that an address names."""
    name = address.partition("=")[0]
    return import_factory(name, f"driver {name}", FACTORY)


def _plugin(address: str, robot_id: int) -> Link:
    """Return the link that a custom factory makes."""
    name, _, text = address.partition("=")
    where = f"driver {name}"
    factory = _factory_of(address)
    try:
        link: Any = factory(robot_id, text)
    except SkyherdError:
        raise
    except Exception as error:
        raise InputError(where, f"{type(error).__name__}: {error}", FACTORY) from error
    if not callable(getattr(link, "write", None)) or not callable(getattr(link, "close", None)):
        raise InputError(where, f"the factory returned {type(link).__name__}", FACTORY)
    if not hasattr(link, "name"):
        link.name = where
    return cast(Link, link)
