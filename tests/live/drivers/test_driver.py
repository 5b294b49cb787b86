"""Driver thread: repetition of fresh commands, watchdog, limits and input errors."""

import threading
import time

import numpy as np
import pytest

from skyherd.errors import InputError, MessageError
from skyherd.live.drivers import STILL, Motion, RobotDriver, SpeedLimits, open_driver
from skyherd.live.drivers.driver import RECOVERY
from skyherd.live.drivers.dry_run import DryRun
from skyherd.live.stop_latch import NOT_HALTED
from skyherd.messages import FlightCommand, VelocityCommand

FAST = SpeedLimits(speed_mps=10, turn_radps=10, acceleration_mps2=1e6, turn_acceleration_radps2=1e6)
"""Limits above all commands of these tests."""


class Wire:
    """Link that records motions, and fails on demand."""

    def __init__(self) -> None:
        self.name, self.written, self.closed, self.broken = "wire", [], 0, None

    def write(self, motion: Motion) -> None:
        assert not self.closed
        self.written.append(motion)
        if self.broken is not None:
            raise self.broken

    def close(self) -> None:
        self.closed += 1


class Stuck(Wire):
    """Link that blocks in `write` until `held` is set."""

    def __init__(self) -> None:
        super().__init__()
        self.held, self.entered = threading.Event(), threading.Event()

    def write(self, motion):
        self.entered.set()
        self.held.wait(10)
        super().write(motion)


class Steps:
    """Clock and pause of a driver thread, which runs one cycle at a time."""

    def __init__(self) -> None:
        self.now_s, self.ended = 0.0, False
        self._go, self._done = threading.Semaphore(0), threading.Semaphore(0)

    def clock(self) -> float:
        return self.now_s

    def pause(self, seconds: float) -> None:
        self._done.release()
        if not self.ended:
            self._go.acquire()
        self.now_s += seconds

    def begin(self) -> None:
        self._done.acquire()

    def round(self) -> None:
        self._go.release()
        self._done.acquire()

    def end(self) -> None:
        self.ended = True
        self._go.release()


@pytest.fixture
def rig():
    wire, steps = Wire(), Steps()
    driver = RobotDriver(
        wire, robot_id=3, limits=FAST, rate_hz=10, hold_s=0.35, clock=steps.clock, pause=steps.pause
    )
    steps.begin()
    yield driver, wire, steps
    steps.end()
    driver.close()


class TestRobotDriver:
    def test_stale_command_is_replaced_by_zero(self, rig) -> None:
        driver, wire, steps = rig
        driver.send(VelocityCommand([1, 3], [9.0, 0.2], [9.0, -0.5]))
        for _ in range(6):
            steps.round()
        # Sent at 0, written at 0.1, 0.2 and 0.3; at 0.4 it is older than 0.35.
        assert wire.written == [STILL, *[Motion(0.2, -0.5)] * 3, *[STILL] * 3]

    def test_zero_before_first_command_and_after_close(self, rig) -> None:
        driver, wire, steps = rig
        steps.round()
        driver.send_motion(Motion(1.0, 1.0))
        steps.end()
        driver.close()
        driver.close()
        assert wire.written[:2] == [STILL, STILL] and wire.written[-3:] == [STILL] * 3
        assert wire.closed == 1
        written = len(wire.written)
        driver.send_motion(Motion(1.0, 1.0))
        assert len(wire.written) == written

    def test_failed_link_is_reported_and_retried(self, rig) -> None:
        driver, wire, steps = rig
        wire.broken = OSError(5, "Input/output error")
        steps.round()
        assert driver.trouble == "wire: cannot be written to: Input/output error"
        wire.broken = ZeroDivisionError("of one's own")
        steps.round()
        assert driver.trouble == "wire: cannot be written to: of one's own" and driver.failed == 2
        wire.broken = None
        for is_over in (False, False, True):
            assert driver.trouble is not None
            steps.round()
            assert (driver.trouble is None) == is_over
        assert driver.written == len(wire.written)

    def test_link_that_fails_every_second_time_is_in_trouble(self, rig) -> None:
        """A socket to a robot that is switched off does so."""
        driver, wire, steps = rig
        driver.send_motion(STILL, stop=4)
        for number in range(12):
            wire.broken = None if number % 2 else OSError(111, "Connection refused")
            steps.round()
            assert driver.trouble is not None and driver.halted == NOT_HALTED

    def test_exit_in_a_write_is_reported_and_retried(self, rig) -> None:
        driver, wire, steps = rig
        wire.broken = SystemExit(3)
        steps.round()
        assert driver.trouble == "wire: cannot be written to: SystemExit 3" and driver.failed == 1
        wire.broken = None
        for _ in range(RECOVERY):
            steps.round()
        assert driver.trouble is None and driver._thread.is_alive()

    def test_speed_grows_from_zero_after_a_failed_write(self) -> None:
        wire, steps = Wire(), Steps()
        limits = SpeedLimits(speed_mps=10, turn_radps=10, acceleration_mps2=1.0, turn_acceleration_radps2=2.0)
        driver = RobotDriver(
            wire, robot_id=3, limits=limits, rate_hz=16, hold_s=9, clock=steps.clock, pause=steps.pause
        )
        steps.begin()
        driver.send_motion(Motion(5.0, -5.0))
        for is_broken in (False, False, True, True, True, False):
            wire.broken = OSError(5, "Input/output error") if is_broken else None
            steps.round()
        steps.end()
        driver.close()
        assert wire.written[2:7] == [
            Motion(2 / 16, -2 / 8),
            Motion(3 / 16, -3 / 8),
            *[Motion(1 / 16, -1 / 8)] * 3,
        ]

    def test_halted_is_the_stop_known_at_the_last_zero(self, rig) -> None:
        driver, wire, steps = rig
        assert driver.halted == NOT_HALTED, "no command yet"
        driver.send_motion(STILL, stop=7)
        assert driver.halted == NOT_HALTED, "not written yet"
        steps.round()
        assert driver.halted == 7
        driver.send_motion(Motion(1.0, 0.0), stop=7)
        steps.round()
        assert driver.halted == NOT_HALTED
        driver.send_motion(STILL, stop=8)
        wire.broken = OSError(5, "Input/output error")
        steps.round()
        assert driver.halted == NOT_HALTED
        wire.broken = None
        for _ in range(RECOVERY):
            assert driver.halted == NOT_HALTED
            steps.round()
        assert driver.halted == 8
        wire.broken = OSError(5, "Input/output error")
        steps.round()
        assert driver.halted == NOT_HALTED, "the last write failed"

    def test_blocked_write_is_trouble_after_the_hold(self) -> None:
        """After it, the speed grows from zero: the watchdog of the robot has stopped it meanwhile."""
        wire, now_s = Stuck(), [0.0]
        wire.held.set()
        limits = SpeedLimits(acceleration_mps2=0.1)
        driver = RobotDriver(wire, robot_id=0, limits=limits, hold_s=0.5, clock=lambda: now_s[0])
        driver.send_motion(STILL, stop=5)
        while driver.halted != 5:
            time.sleep(0.001)
        wire.held.clear()
        wire.entered.clear()
        assert wire.entered.wait(10)
        driver._limiter.last = Motion(0.3, 0.0)
        now_s[0] = 0.5
        assert driver.trouble is None
        now_s[0] = 3.5
        driver.send_motion(Motion(0.3, 0.0), stop=5)
        assert driver.trouble == "wire: a write has blocked for 3.5 s"
        wire.held.set()
        while driver.trouble is not None:
            time.sleep(0.001)
        driver.close()
        assert max(motion.forward_mps for motion in wire.written) <= 0.1 * 0.2 + 1e-12

    @pytest.mark.filterwarnings("ignore::pytest.PytestUnhandledThreadExceptionWarning")
    def test_dead_thread_is_trouble(self) -> None:
        driver = RobotDriver(Wire(), robot_id=0, limits=FAST, pause=lambda seconds: 1 / 0)
        driver._thread.join(10)
        assert driver.trouble == "wire: the thread that writes has ended" and driver.halted == NOT_HALTED
        driver.close()

    def test_commands_are_limited_before_writing(self, rig) -> None:
        driver, wire, steps = rig
        for motion in (Motion(float("nan"), 0.0), Motion(1e300, float("-inf")), Motion(50.0, -50.0)):
            driver.send_motion(motion)
            steps.round()
        assert wire.written[1:] == [STILL, STILL, Motion(10.0, -10.0)]

    def test_backward_clock_stops_the_robot(self, rig) -> None:
        driver, wire, steps = rig
        driver.send_motion(Motion(1.0, 0.0))
        steps.now_s = -100.0
        steps.round()
        assert wire.written[-1] == STILL

    def test_send_never_blocks_on_the_link(self) -> None:
        wire = Stuck()
        driver = RobotDriver(wire, robot_id=0, limits=FAST)
        assert wire.entered.wait(10)
        for number in range(1000):  # All calls must return while the writing thread is blocked.
            driver.send_motion(Motion(number / 1000, 0.0))
        assert not wire.written
        wire.held.set()
        driver.close()
        assert wire.written[-1] == STILL and wire.closed == 1

    def test_close_reports_blocked_link(self, monkeypatch) -> None:
        monkeypatch.setattr("skyherd.live.drivers.driver.CLOSE_S", 0.05)
        wire = Stuck()
        driver = RobotDriver(wire, robot_id=0, limits=FAST)
        assert wire.entered.wait(10)
        words = "wire: blocks since 0.05 s; the robot may not have received"
        with pytest.warns(RuntimeWarning, match=words) as caught:
            driver.close()
        assert caught[0].filename == __file__, "the warning names the caller's line"
        assert "may not have received zero" in driver.trouble
        assert not wire.closed
        wire.held.set()
        driver._thread.join(10)
        driver.close()
        assert wire.written[-3:] == [STILL] * 3 and wire.closed == 1 and driver.trouble is None

    def test_wait_for_new_command_keeps_shortest_interval(self, rig) -> None:
        """A quarter of the period always passes. A new command shortens only the rest."""
        driver, _, _ = rig
        waits = []

        class RecordedEvent(threading.Event):
            def wait(self, timeout=None):
                waits.append(timeout)
                return self.is_set()

        driver._closing, driver._news = RecordedEvent(), RecordedEvent()
        driver._news.set()
        driver._await_news(2.0)
        assert waits == [0.5, 1.5] and not driver._news.is_set()
        driver._closing.set()
        driver._await_news(2.0)
        assert waits == [0.5, 1.5, 0.5], "the end of the driver is not delayed"

    def test_acceleration_is_limited_by_time_between_writes(self) -> None:
        wire, steps = Wire(), Steps()
        steps.now_s = 1000.0
        limits = SpeedLimits(speed_mps=10, turn_radps=10, acceleration_mps2=1.0, turn_acceleration_radps2=2.0)
        driver = RobotDriver(
            wire, robot_id=3, limits=limits, rate_hz=16, hold_s=9, clock=steps.clock, pause=steps.pause
        )
        steps.begin()
        driver.send_motion(Motion(5.0, -5.0))
        for _ in range(3):
            steps.round()
        steps.end()
        driver.close()
        assert wire.written[1:4] == [Motion(number / 16, -number / 8) for number in (1, 2, 3)]

    def test_new_command_is_written_immediately(self, monkeypatch) -> None:
        monkeypatch.setattr("skyherd.live.drivers.driver.MIN_SHARE", 0.0)
        came = threading.Event()

        class Bell(Wire):
            def write(self, motion):
                super().write(motion)
                if motion.forward_mps:
                    came.set()

        # With a period of one hour, only the new command can wake the thread.
        driver = RobotDriver(Bell(), robot_id=0, limits=FAST, rate_hz=1 / 3600, hold_s=60)
        with driver:
            driver.send_motion(Motion(0.1, 0.0))
            assert came.wait(10)

    def test_default_rate_is_20_hz_and_hold_half_a_second(self) -> None:
        wire, steps = Wire(), Steps()
        driver = RobotDriver(wire, robot_id=3, limits=FAST, clock=steps.clock, pause=steps.pause)
        steps.begin()
        driver.send_motion(Motion(1.0, 0.0))
        for _ in range(20):
            steps.round()
        assert steps.now_s == pytest.approx(20 / 20)
        # Ten sums of 0.05 are slightly less than 0.5.
        assert wire.written == [STILL, *[Motion(1.0, 0.0)] * 10, *[STILL] * 10]
        steps.end()
        driver.close()

    def test_driver_that_is_never_closed_ends_with_the_process(self, rig) -> None:
        assert rig[0]._thread.daemon

    def test_options_are_given_by_name(self) -> None:
        with pytest.raises(TypeError, match="positional"):
            RobotDriver(Wire(), 3)

    def test_command_without_the_robot_is_refused(self, rig) -> None:
        driver, _, _ = rig
        with pytest.raises(MessageError, match="; robot 3 among them"):
            driver.send(VelocityCommand([1, 2], [0, 0], [0, 0]))
        with pytest.raises(MessageError, match="; robot 3 among them"):
            driver.send(VelocityCommand([2, 7], [1, 1], [1, 1]))


class TestFlight:
    def test_flight_command_is_in_the_body_frame(self, rig) -> None:
        driver, wire, steps = rig
        driver.flies = True
        # Right in the image is right, and up in the image is forward.
        driver.send_flight(FlightCommand(3, np.array([0.5, -2.0]), climb_mps=1.0, yaw_rate_radps=0.25))
        steps.round()
        assert wire.written[-1] == Motion(2.0, 0.25, left_mps=-0.5, up_mps=1.0, flies=True)

    def test_all_motions_of_flying_unit_are_marked(self, rig) -> None:
        """Straight flight, and the zero after a stale command, are marked as flight too."""
        driver, wire, steps = rig
        driver.flies = True
        driver.send_flight(FlightCommand(3, np.array([0.0, -1.0]), climb_mps=0.0, yaw_rate_radps=0.0))
        for _ in range(5):
            steps.round()
        assert Motion(1.0, 0.0, flies=True) in wire.written
        assert wire.written[-1] == Motion(0.0, 0.0, flies=True)
        assert {motion.flies for motion in wire.written[1:]} == {True}

    def test_flight_command_for_wheels_is_refused(self, rig) -> None:
        with pytest.raises(InputError, match="a flight command for wheels"):
            rig[0].send_flight(FlightCommand.hold(3))


def test_dry_run_prints_changes_only(capsys) -> None:
    link = DryRun(4)
    flight = Motion(0.1, 0.0, 0.2, 0.3, flies=True)
    for motion in (STILL, Motion(0.1, -0.2), Motion(0.1, -0.2), STILL, flight):
        link.write(motion)
    assert capsys.readouterr().out.splitlines() == [
        "robot 4: +0.100 m/s, -0.200 rad/s",
        "robot 4: +0.000 m/s, +0.000 rad/s",
        "robot 4: +0.100 m/s, +0.000 rad/s, left +0.200 m/s, up +0.300 m/s",
    ]


class Own(Wire):
    def __init__(self, robot_id, text):
        super().__init__()
        self.robot_id, self.text = robot_id, text


def test_custom_link_receives_motions(tmp_path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    (tmp_path / "own_wheels.py").write_text(
        "seen = []\n"
        "class Wheels:\n"
        "    def __init__(self, robot_id, text): seen.append((robot_id, text))\n"
        "    def write(self, motion): seen.append(motion)\n"
        "    def close(self): seen.append('closed')\n"
        "def nothing(robot_id, text): return 3\n"
        "def broken(robot_id, text): raise RuntimeError('no wheels')\n"
    )
    open_driver("own_wheels:Wheels=left", robot_id=7).close()
    import own_wheels

    assert own_wheels.seen[0] == (7, "left") and own_wheels.seen[-2:] == [STILL, "closed"]
    for name, words in (("nothing", "returned int"), ("broken", "RuntimeError: no wheels"), ("no", "no att")):
        with pytest.raises(InputError, match=words):
            open_driver(f"own_wheels:{name}", robot_id=7)


class TestInput:
    @pytest.mark.parametrize(
        ("address", "words"),
        [
            ("", "no driver ''"),
            ("ros3://host/cmd_vel", "no driver"),
            ("udp://host", "host or a port"),
            ("udp://127.0.0.1:abc", "Port could not be cast|invalid literal"),
            ("serial://", "no port"),
            ("serial:///dev/nowhere", "No such file"),
            ("ros2:///cmd_vel?type=Pose", "Twist or TwistStamped"),
            ("ros2:///cmd vel", "letters, digits"),
            ("ros2:///cmd_vel?domain=300", "0 to 232"),
            ("ros2:///cmd_vel?typ=Twist", "option 'typ'"),
            ("mqtt://user:secret@127.0.0.1:1/topic", "refused"),
            ("mqtt://user:secret@127.0.0.1:abc/topic", "Port could not be cast|invalid literal"),
            ("mqtt://127.0.0.1/a%23", "without"),
        ],
    )
    def test_invalid_address_is_one_clear_line(self, address, words) -> None:
        pytest.importorskip("serial")
        pytest.importorskip("paho.mqtt")
        with pytest.raises(InputError, match=words) as raised:
            open_driver(address, robot_id=0)
        assert "\n" not in str(raised.value) and "secret" not in str(raised.value)

    @pytest.mark.parametrize("numbers", [{"rate_hz": 0.0}, {"hold_s": float("nan")}, {"hold_s": -1.0}])
    def test_invalid_rate_and_hold_are_refused(self, numbers) -> None:
        with pytest.raises(InputError, match=next(iter(numbers))):
            open_driver("dry-run", robot_id=0, **numbers)

    @pytest.mark.parametrize(
        ("address", "module", "package"),
        [
            ("ros2:///cmd_vel", "zenoh", "eclipse-zenoh"),
            ("mqtt://127.0.0.1", "paho.mqtt.client", "paho-mqtt"),
            ("serial:///dev/ttyUSB0", "serial", "pyserial"),
        ],
    )
    def test_missing_package_is_reported(self, address, module, package, monkeypatch) -> None:
        monkeypatch.setitem(__import__("sys").modules, module, None)
        with pytest.raises(InputError, match=f"{package} is not installed; pip install 'skyherd\\[live\\]'"):
            open_driver(address, robot_id=0)


@pytest.mark.parametrize(
    ("age_s", "moves"),
    [
        (-0.25, False),
        (-(2**-20), False),
        (0.0, True),
        (0.25, True),
        (0.375, False),
        (0.5, False),
        (-1.5, False),
    ],
)
def test_motion_is_written_from_age_0_to_below_the_hold(age_s, moves) -> None:
    """Ages are exact in binary. The hold time of 0.375 s is excluded."""
    wire, steps = Wire(), Steps()
    driver = RobotDriver(
        wire, robot_id=3, limits=FAST, rate_hz=8, hold_s=0.375, clock=steps.clock, pause=steps.pause
    )
    steps.begin()
    steps.now_s = 10.0
    driver.send_motion(Motion(1.0, 0.0))
    steps.now_s = 10.0 + age_s - 0.125  # A round starts with a pause of 0.125 s.
    if age_s < 0:  # A clock that goes back allows no immediate growth.
        driver._limiter.last = Motion(1.0, 0.0)
    steps.round()
    assert (wire.written[-1] != STILL) == moves
    steps.end()
    driver.close()


def test_close_writes_three_zeros_and_nothing_else(rig) -> None:
    driver, wire, steps = rig
    driver.send_motion(Motion(1.0, 0.0))
    steps.round()
    closing = threading.Thread(target=driver.close)
    closing.start()
    assert driver._closing.wait(10)
    steps.end()
    closing.join(10)
    assert wire.written == [STILL, Motion(1.0, 0.0), STILL, STILL, STILL]
    assert (wire.closed, driver.written) == (1, 5)


@pytest.mark.filterwarnings("ignore::pytest.PytestUnhandledThreadExceptionWarning")
def test_zeros_come_last_also_after_an_error_in_the_thread() -> None:
    """An error of the clock or the pause ends the thread. The robot must stop nevertheless."""
    wire = Wire()
    raised = []

    def pause(seconds):
        raised.append(seconds)
        raise ZeroDivisionError

    driver = RobotDriver(wire, robot_id=0, limits=FAST, rate_hz=4, pause=pause)
    driver._thread.join(10)
    assert raised == [0.25] and wire.written == [STILL] * 4 and wire.closed == 1
