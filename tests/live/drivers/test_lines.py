"""Lines of text over a pseudo terminal and over UDP."""

import os
import re
import shutil
import socket
import subprocess
from contextlib import suppress
from functools import reduce
from operator import xor
from pathlib import Path

import pytest

from skyherd.errors import InputError
from skyherd.live.drivers import STILL, Motion, open_driver
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


def test_pseudo_terminal_needs_an_option(tmp_path) -> None:
    """It reports an empty output buffer, so that commands of many seconds wait for a reader that is held."""
    serial = pytest.importorskip("serial")
    ours, theirs = os.openpty()
    port = tmp_path / "port"
    port.symlink_to(os.ttyname(theirs))
    with serial.Serial(str(port)) as terminal:
        terminal.write(b"V" * 1000)
        assert terminal.out_waiting == 0
    with pytest.raises(InputError, match=r"a pseudo-terminal, .*; a serial port, or \?pty=yes"):
        open_driver(f"serial://{port}", robot_id=5)
    with pytest.raises(InputError, match="pty 'maybe'; yes or no"):
        open_driver(f"serial://{port}?pty=maybe", robot_id=5)
    open_driver(f"serial://{port}?pty=yes", robot_id=5).close()
    os.close(ours)
    os.close(theirs)


def test_full_serial_port_drops_lines_and_reopens() -> None:
    pytest.importorskip("serial")
    ours, theirs = os.openpty()
    link = SerialLines(f"serial://{os.ttyname(theirs)}?baud=57600&pty=yes", 5)
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


PROGRAM = """
#include <math.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#define ROBOT 3
#define MAX_MPS 0.3f
#define MAX_RADPS 3.0f
static int last = 0, driving = 0, known = 0, heard_ms, now_ms, drove;
static float speed;
static int millis(void) { return now_ms; }
static void drive(float v, float w) { drove = 1; speed = v; }
static void hear(char *line) {
    int id, number;
    float v, w;
    BLOCK
}
int main(void) {
    char line[200];
    while (fgets(line, sizeof line, stdin)) {
        drove = 0;
        if (line[0] == 'P') driving = 0; else hear(line);
        if (drove) printf("%.4f\\n", speed); else puts("-");
    }
}
"""


def test_documented_program_obeys_new_lines_only(tmp_path) -> None:
    """The C program of the documentation has the rules of `examples/firmware/wheels.py`. P is a pause."""
    compiler = shutil.which("cc") or shutil.which("gcc")
    if compiler is None:
        pytest.skip("no C compiler")
    page = Path(__file__).parents[3] / "docs/live/drivers.md"
    block = page.read_text().split("```c\n")[1].split("```")[0]
    (tmp_path / "robot.c").write_text(PROGRAM.replace("BLOCK", block))
    subprocess.run([compiler, "-o", "robot", "robot.c", "-lm"], cwd=tmp_path, check=True)
    said = [
        (0.1, 40000, "-"),  # no zero yet
        (0.0, 40001, "0.0000"),
        (0.1, 40002, "0.1000"),
        (0.2, 40002, "-"),  # repeated
        (0.2, 39000, "-"),  # late
        (0.0, 39000, "0.0000"),  # zero always stops
        (0.2, 40001, "-"),
        (0.2, 65000, "0.2000"),
        (0.1, 3, "0.1000"),  # the number has wrapped
        None,
        (0.2, 2, "-"),  # waited during the pause
        (0.0, 1, "0.0000"),  # the driver was restarted
        (0.1, 2, "0.1000"),
    ]
    lines = [b"P\n" if one is None else line_of(3, one[1], Motion(one[0], 0.0)) for one in said]
    done = subprocess.run([tmp_path / "robot"], input=b"".join(lines), capture_output=True, check=True)
    assert done.stdout.decode().split() == ["-" if one is None else one[2] for one in said]
