"""Lines of text over a pseudo terminal and over UDP."""

import os
import re
import socket
from contextlib import suppress
from functools import reduce
from operator import xor

import pytest

from skyherd.live.drivers import STILL, Motion
from skyherd.live.drivers.lines import SerialLines, UdpLines, line_of


def read_line(line: bytes) -> list[str]:
    """Return the fields of a line after a check of its checksum, like a microcontroller."""
    text, digits = re.fullmatch(rb"([\x20-\x7e]*)\*([0-9A-F]{2})\n", line).groups()
    assert reduce(xor, text) == int(digits, 16)
    return text.decode().split(",")


def test_line_has_the_documented_format() -> None:
    assert line_of(3, 17, Motion(0.125, -0.4)) == b"V,3,17,0.1250,-0.4000*4C\n"
    assert read_line(line_of(3, 65536 + 4, Motion(-0.00001, 0.0)))[2:] == ["4", "-0.0000", "0.0000"]
    assert read_line(line_of(1, 0, Motion(1, 2, 3, 4, flies=True))) == [
        "F",
        "1",
        "0",
        "1.0000",
        "3.0000",
        "4.0000",
        "2.0000",
    ]
    # A flying unit's stop has four speeds too: receivers of F lines only must get it.
    assert read_line(line_of(1, 0, Motion(0.0, 0.0, flies=True))) == ["F", "1", "0", *["0.0000"] * 4]


def test_checksum_detects_any_flipped_bit() -> None:
    line = line_of(3, 17, Motion(0.125, -0.4))
    for place in range(line.index(b"*")):
        for bit in range(8):
            damaged = line[:place] + bytes([line[place] ^ 1 << bit]) + line[place + 1 :]
            with pytest.raises((AssertionError, AttributeError)):
                read_line(damaged)


def test_udp_link_sends_lines() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as robot:
        robot.bind(("127.0.0.1", 0))
        robot.settimeout(10)
        link = UdpLines(f"udp://127.0.0.1:{robot.getsockname()[1]}", 5)
        link.write(Motion(0.1, 0.2))
        link.write(STILL)
        assert read_line(robot.recv(100)) == ["V", "5", "0", "0.1000", "0.2000"]
        assert read_line(robot.recv(100)) == ["V", "5", "1", "0.0000", "0.0000"]
        link.close()


def test_full_serial_port_drops_lines_and_reopens() -> None:
    pytest.importorskip("serial")
    ours, theirs = os.openpty()
    link = SerialLines(f"serial://{os.ttyname(theirs)}?baud=57600", 5)
    link.write(Motion(0.1, 0.2))
    assert read_line(os.read(ours, 100)) == ["V", "5", "0", "0.1000", "0.2000"]
    with pytest.raises(OSError):
        for _ in range(10_000):  # Without a reader, the queue must fill up.
            link.write(Motion(0.1, 0.2))
    os.set_blocking(ours, False)
    with suppress(BlockingIOError):
        while os.read(ours, 65536):
            pass
    link.write(STILL)  # The port is reopened.
    os.set_blocking(ours, True)
    assert b",0.0000,0.0000*" in os.read(ours, 65536)
    link.close()
    link.close()
    os.close(ours)
    os.close(theirs)
