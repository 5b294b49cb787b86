r"""Lines of text for robots with a microcontroller, over a serial port or UDP.

    V,3,17,0.1250,-0.4000*4C\n

contains the robot, the line number (it wraps from 65535 to 0, and reveals losses), the forward speed in m/s
and the turn rate in rad/s, counter-clockwise. After the star follows the exclusive or of all bytes before it,
in two hexadecimal digits. The line of a flying unit is `F,robot,number,forward,left,up,turn*HH`.
"""

import os
import re
import socket
from functools import reduce
from operator import xor
from typing import Any, NamedTuple
from urllib.parse import parse_qsl, urlsplit

from skyherd.errors import InputError
from skyherd.live.drivers.link import Motion
from skyherd.plugins import import_extra

BAUD = 115200
"""Default speed of a serial port, bit/s. *Chosen*: usual, and a line takes 3 ms."""

WRITE_S = 0.2
"""Timeout of writing a line, s. *Chosen*: the limit of `Link.write`."""

WAITING_BYTES = 64
"""Bytes in the output buffer above which a line is dropped. *Chosen*: about two lines."""

PSEUDO = re.compile(r"/dev/(pts/|ttys)\d+")
"""Pseudo-terminals of Linux and macOS. They report an empty output buffer, so that a reader that is held gets
commands of many seconds later."""

MAX_BAUD = 100_000_000
"""Largest speed of a serial port, bit/s. *Chosen*: above any real one."""


class UdpPlace(NamedTuple):
    """Destination of UDP packets."""

    host: str
    port: int


class SerialPlace(NamedTuple):
    """A serial port, its speed, bit/s, and whether it may be a pseudo-terminal."""

    path: str
    baud: int
    allows_pseudo: bool = False


def udp_place(address: str, robot_id: int) -> UdpPlace:
    """Return the host and port of `udp://host:port`. `robot_id` is not used.

    Raises:
        InputError: the host or the port is missing.
        ValueError: the port is invalid.
    """
    parts = urlsplit(address)
    if not parts.hostname or not parts.port:
        raise InputError(f"driver {address}", "a host or a port is missing", "udp://192.168.1.23:9000")
    return UdpPlace(parts.hostname, parts.port)


def serial_place(address: str, robot_id: int) -> SerialPlace:
    """Return the port and speed of `serial:///dev/ttyACM0?baud=57600`. `robot_id` is not used.

    The port need not exist. A pseudo-terminal needs the option `pty=yes`.

    Raises:
        InputError: the port is missing or a pseudo-terminal, an option is unknown, or the speed is invalid.
    """
    parts, where, example = urlsplit(address), f"driver {address}", "serial:///dev/ttyUSB0?baud=115200"
    options = dict(parse_qsl(parts.query, keep_blank_values=True))
    if not parts.path.strip("/") or parts.netloc:
        raise InputError(where, "no port", example)
    if unknown := sorted(set(options) - {"baud", "pty"}):
        raise InputError(where, f"option {unknown[0]!r}", f"baud and pty, as in {example}")
    baud = options.get("baud", str(BAUD))
    if not baud.isdecimal() or not 0 < int(baud) <= MAX_BAUD:
        raise InputError(where, f"baud {baud!r}", f"a number of bits a second, as in {example}")
    if (pseudo := options.get("pty", "no")) not in ("yes", "no"):
        raise InputError(where, f"pty {pseudo!r}", "yes or no")
    place = SerialPlace(parts.path, int(baud), pseudo == "yes")
    _check_pseudo(place, where)
    return place


def _check_pseudo(place: SerialPlace, where: str) -> None:
    """Refuse a pseudo-terminal unless the user allows it.

    Raises:
        InputError: the port is one.
    """
    if not place.allows_pseudo and PSEUDO.fullmatch(os.path.realpath(place.path)):
        what = "a pseudo-terminal, which keeps commands of many seconds for a reader that is held"
        raise InputError(where, what, "a serial port, or ?pty=yes if the reader drops old lines")


def line_of(robot_id: int, number: int, motion: Motion) -> bytes:
    """Return a motion as a line with its line end. `number` counts the lines."""
    speeds = [motion.forward_mps, motion.turn_radps]
    if motion.flies:
        speeds = [motion.forward_mps, motion.left_mps, motion.up_mps, motion.turn_radps]
    values = ",".join(f"{speed + 0.0:.4f}" for speed in speeds)
    text = f"{'F' if motion.flies else 'V'},{robot_id},{number % 65536},{values}".encode("ascii")
    return b"%b*%02X\n" % (text, reduce(xor, text, 0))


class UdpLines:
    """Link that sends each line as a UDP packet.

    Args:
        address: `udp://host:port`.
        robot_id: the robot.

    Raises:
        InputError: the host is unknown, or the address has no port.
    """

    def __init__(self, address: str, robot_id: int) -> None:
        self.name, self._robot, self._number = address, robot_id, 0
        try:
            found = socket.getaddrinfo(*udp_place(address, robot_id), type=socket.SOCK_DGRAM)
            self._socket = socket.socket(*found[0][:3])
            self._socket.connect(found[0][4])
            self._socket.setblocking(False)
        except InputError:
            raise
        except (OSError, ValueError) as error:
            raise InputError(f"driver {address}", _words(error), "udp://192.168.1.23:9000") from None

    def write(self, motion: Motion) -> None:
        """Send a motion as a packet; see `Link.write`."""
        self._socket.send(line_of(self._robot, self._number, motion))
        self._number += 1

    def close(self) -> None:
        """Close the socket; see `Link.close`."""
        self._socket.close()


class SerialLines:
    """Link that writes lines to a serial port, and reopens it after a failure.

    Args:
        address: `serial:///dev/ttyUSB0`, `serial:///dev/ttyACM0?baud=57600`; `?pty=yes` allows a
            pseudo-terminal.
        robot_id: the robot.

    Raises:
        InputError: the port cannot be opened or is a pseudo-terminal, or pyserial is not installed.
    """

    def __init__(self, address: str, robot_id: int) -> None:
        self._place = serial_place(address, robot_id)
        self._serial = import_extra("serial", "pyserial", f"driver {address}", "live")
        self.name, self._robot, self._number = address, robot_id, 0
        try:
            self._port: Any = self._open()
        except InputError:
            raise
        except (OSError, ValueError) as error:
            raise InputError(f"driver {address}", _words(error), "an existing serial port") from None

    def _open(self) -> Any:
        _check_pseudo(self._place, f"driver {self.name}")
        path, baud = self._place.path, self._place.baud
        return self._serial.Serial(path, baud, write_timeout=WRITE_S, exclusive=True)

    def write(self, motion: Motion) -> None:
        """Write a motion as a line; see `Link.write`."""
        try:
            if self._port is None:
                self._port = self._open()
            if self._port.out_waiting > WAITING_BYTES:
                raise OSError("the output buffer of the port is full")
            self._port.write(line_of(self._robot, self._number, motion))
            self._number += 1
        except OSError:
            self.close()
            raise

    def close(self) -> None:
        """Close the port; see `Link.close`."""
        if self._port is not None:
            port, self._port = self._port, None
            port.close()


def _words(error: Exception) -> str:
    return " ".join(str(getattr(error, "strerror", None) or error).split()) or type(error).__name__
