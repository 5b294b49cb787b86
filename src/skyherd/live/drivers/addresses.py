"""Which robot an address means."""

import re
import time
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
from skyherd.plugins import import_factory

PLUGIN = re.compile(r"[A-Za-z_][\w.]*:[A-Za-z_]\w*(=.*)?", re.DOTALL)
"""`module:factory`, perhaps with `=TEXT`."""

ALLOWED = "ros2://…, mqtt://…, serial:///dev/ttyUSB0, udp://host:port, dry-run, module:factory"
"""What an address may be, for complaints."""

DRY_RUN = "dry-run"
"""Address that prints what a robot would do."""

WORLD = "world"
"""Address of wheels and autopilots that `skyherd world` simulates. A lab may have it; its processes open it
themselves, since it needs their radio."""

FACTORY = "a function of (robot_id, text) that returns an object with write(motion) and close()"
"""What a plug-in has to be."""


def open_driver(
    address: str,
    *,
    robot_id: int,
    limits: SpeedLimits = LIMITS,
    flies: bool = False,
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
        flies: whether it is a unit that flies.
        rate_hz: how often something is written.
        hold_s: age at which a command is forgotten and zero is sent.
        clock: gives the time, s.

    Raises:
        InputError: it cannot be opened; one clear line, without a password that the address may contain.
    """
    link = _link_of(address, robot_id)
    return RobotDriver(
        link, robot_id=robot_id, limits=limits, flies=flies, rate_hz=rate_hz, hold_s=hold_s, clock=clock
    )


def check_driver(address: str, robot_id: int, *, imports: bool = False) -> None:
    """Refuse an address that no robot of a lab can have; nothing is opened, and nobody is asked.

    Args:
        address: see `open_driver`, or `WORLD`.
        robot_id: the robot.
        imports: also import the factory of a driver of one's own, which has to be on this machine then.

    Raises:
        InputError: there is no such scheme, or host, port, speed, topic or option are none.
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
    """The link that an address means."""
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
    """How links of one scheme are made.

    Attributes:
        parse: takes an address apart, and raises ValueError if it cannot be one.
        open: makes a link of it.
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
"""What makes a link, by the scheme of its address."""


def _transport_of(address: str, allowed: str) -> Transport | None:
    """What makes the links of an address; None if that is a factory of one's own."""
    scheme = address.partition("://")[0].lower() if "://" in address else ""
    if scheme not in _TRANSPORTS and not PLUGIN.fullmatch(address):
        raise InputError("driver", f"no driver {_shown(address)!r}", allowed)
    return _TRANSPORTS.get(scheme)


@contextmanager
def _one_line(address: str) -> Iterator[None]:
    """What a part of an address cannot be, as one clear line without its password."""
    try:
        yield
    except InputError:
        raise
    except ValueError as error:
        raise InputError(f"driver {_shown(address)}", str(error), ALLOWED) from None


def _shown(address: str) -> str:
    """An address without user and password."""
    return re.sub("//[^/]*@", "//", address)


def _factory_of(address: str) -> Callable[..., object]:
    """The factory of one's own that an address names."""
    name = address.partition("=")[0]
    return import_factory(name, f"driver {name}", FACTORY)


def _plugin(address: str, robot_id: int) -> Link:
    """What a factory of one's own makes."""
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
