"""The thread that repeats fresh commands and forgets old ones, on a clock of its own."""

import threading
import time

import numpy as np
import pytest

from skyherd.errors import InputError, MessageError
from skyherd.live.drivers import STILL, Motion, RobotDriver, SpeedLimits, open_driver
from skyherd.live.drivers.dry_run import DryRun
from skyherd.messages import FlightCommand, VelocityCommand

FAST = SpeedLimits(speed_mps=10, turn_radps=10, acceleration_mps2=1e6, turn_acceleration_radps2=1e6)
"""Limits that let everything of these tests pass."""


class Wire:
    """A link that keeps what was written, and fails when told to."""

    def __init__(self) -> None:
        self.name, self.written, self.closed, self.broken = "wire", [], 0, None

    def write(self, motion: Motion) -> None:
        assert not self.closed
        self.written.append(motion)
        if self.broken is not None:
            raise self.broken

    def close(self) -> None:
        self.closed += 1


class Steps:
    """Clock and pause of a driver's thread, which runs one round at a time."""

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


def test_a_command_is_repeated_while_fresh_and_then_zero_is_sent(rig) -> None:
    driver, wire, steps = rig
    driver.send(VelocityCommand([1, 3], [9.0, 0.2], [9.0, -0.5]))
    for _ in range(6):
        steps.round()
    # Sent at 0, written at 0.1, 0.2 and 0.3; at 0.4 it is older than 0.35.
    assert wire.written == [STILL, *[Motion(0.2, -0.5)] * 3, *[STILL] * 3]


def test_nothing_moves_before_the_first_command_and_after_close(rig) -> None:
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


def test_a_link_that_fails_is_told_and_tried_again(rig) -> None:
    driver, wire, steps = rig
    wire.broken = OSError(5, "Input/output error")
    steps.round()
    assert driver.trouble == "wire: cannot be written to: Input/output error"
    wire.broken = ZeroDivisionError("of one's own")
    steps.round()
    assert driver.trouble == "wire: cannot be written to: of one's own" and driver.failed == 2
    wire.broken = None
    steps.round()
    assert driver.trouble is None and driver.written == len(wire.written)


@pytest.mark.smoke
def test_commands_are_limited_before_they_are_written(rig) -> None:
    driver, wire, steps = rig
    for motion in (Motion(float("nan"), 0.0), Motion(1e300, float("-inf")), Motion(50.0, -50.0)):
        driver.send_motion(motion)
        steps.round()
    assert wire.written[1:] == [STILL, STILL, Motion(10.0, -10.0)]


def test_a_clock_that_goes_back_stops_the_robot(rig) -> None:
    driver, wire, steps = rig
    driver.send_motion(Motion(1.0, 0.0))
    steps.now_s = -100.0
    steps.round()
    assert wire.written[-1] == STILL


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
    """Ages are exact in binary; the hold is 0.375 s and excluded."""
    wire, steps = Wire(), Steps()
    driver = RobotDriver(
        wire, robot_id=3, limits=FAST, rate_hz=8, hold_s=0.375, clock=steps.clock, pause=steps.pause
    )
    steps.begin()
    steps.now_s = 10.0
    driver.send_motion(Motion(1.0, 0.0))
    steps.now_s = 10.0 + age_s - 0.125  # a round begins with a pause of 0.125 s
    if age_s < 0:  # time that goes back allows no growth of speed at once
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
    """An error of the clock or the pause ends the thread; the robot must be stopped all the same."""
    wire = Wire()
    raised = []

    def pause(seconds):
        raised.append(seconds)
        raise ZeroDivisionError

    driver = RobotDriver(wire, robot_id=0, limits=FAST, rate_hz=4, pause=pause)
    driver._thread.join(10)
    assert raised == [0.25] and wire.written == [STILL] * 4 and wire.closed == 1


def test_row_of_the_robot_is_taken_from_a_team_s_command(rig) -> None:
    driver, wire, steps = rig
    driver.send(VelocityCommand([1, 2, 3, 4], [9.0, 9.0, 0.25, 9.0], [9.0, 9.0, -0.5, 9.0]))
    steps.round()
    assert wire.written[-1] == Motion(0.25, -0.5)


def test_speed_grows_by_the_time_between_two_writes() -> None:
    wire, steps = Wire(), Steps()
    limits = SpeedLimits(speed_mps=10, turn_radps=10, acceleration_mps2=2.0, turn_acceleration_radps2=1e6)
    driver = RobotDriver(
        wire, robot_id=3, limits=limits, rate_hz=8, hold_s=10, clock=steps.clock, pause=steps.pause
    )
    steps.begin()
    driver.send_motion(Motion(5.0, 0.0))
    for _ in range(3):
        steps.round()
    steps.end()
    driver.close()
    # 2 m/s² for 1/8 s at each round.
    assert [motion.forward_mps for motion in wire.written[:4]] == [0.0, 0.25, 0.5, 0.75]


def test_defaults_are_20_writes_a_second_and_half_a_second_of_hold() -> None:
    pauses, wire = [], Wire()
    done = threading.Event()

    def pause(seconds):
        pauses.append(seconds)
        done.wait(10)

    driver = RobotDriver(wire, robot_id=0, pause=pause)
    done.set()
    driver.close()
    assert pauses[0] == 1 / 20 and driver.hold_s == 0.5 and not driver.flies
    assert driver._thread.daemon, "a link that hangs would keep the process from ending"


def test_error_without_words_is_told_by_its_name(rig) -> None:
    driver, wire, steps = rig
    wire.broken = TimeoutError()
    steps.round()
    assert driver.trouble == "wire: cannot be written to: TimeoutError"
    wire.broken = OSError("two\nlines")
    steps.round()
    assert driver.trouble == "wire: cannot be written to: two lines"


def test_pause_of_its_own_lasts_its_share_and_ends_with_the_news(monkeypatch) -> None:
    """A quarter of the interval passes in any case; then news end the pause, and are forgotten."""
    waits = []
    driver = RobotDriver(Wire(), robot_id=0, limits=FAST, pause=lambda seconds: time.sleep(0.001))

    class Flag:
        def __init__(self, name, answer):
            self.name, self.answer, self.cleared = name, answer, 0

        def wait(self, seconds):
            waits.append((self.name, seconds))
            return self.answer

        def clear(self):
            self.cleared += 1

        def set(self):
            self.answer = True

    driver.close()
    for is_closing, expected in ((False, [("closing", 2.0), ("news", 6.0)]), (True, [("closing", 2.0)])):
        waits.clear()
        driver._closing, driver._news = Flag("closing", is_closing), Flag("news", True)
        driver._await_news(8.0)
        assert waits == expected and driver._news.cleared == 1


def test_close_waits_two_seconds_for_a_link_that_hangs(rig) -> None:
    driver, _, _ = rig
    thread, waits = driver._thread, []

    class Hung:
        def join(self, seconds):
            waits.append(seconds)

    driver._thread = Hung()
    driver.close()
    assert waits == [2.0]
    driver._thread = thread


def test_close_from_its_own_thread_does_not_wait_for_itself() -> None:
    wire = Wire()
    drivers: list[RobotDriver] = []
    ready = threading.Event()

    def pause(seconds):
        ready.wait(10)
        drivers[0].close()

    drivers.append(RobotDriver(wire, robot_id=0, limits=FAST, pause=pause))
    ready.set()
    drivers[0]._thread.join(10)
    assert wire.written == [STILL] * 4 and wire.closed == 1


def test_the_sender_never_waits_for_the_link() -> None:
    held, entered = threading.Event(), threading.Event()

    class Stuck(Wire):
        def write(self, motion):
            entered.set()
            held.wait(10)
            super().write(motion)

    wire = Stuck()
    driver = RobotDriver(wire, robot_id=0, limits=FAST)
    assert entered.wait(10)
    for number in range(1000):  # with the writing thread held, these must all return
        driver.send_motion(Motion(number / 1000, 0.0))
    assert not wire.written
    held.set()
    driver.close()
    assert wire.written[-1] == STILL and wire.closed == 1


def test_a_new_command_is_written_without_waiting_for_the_next_turn(monkeypatch) -> None:
    monkeypatch.setattr("skyherd.live.drivers.driver.MIN_SHARE", 0.0)
    came = threading.Event()

    class Bell(Wire):
        def write(self, motion):
            super().write(motion)
            if motion.forward_mps:
                came.set()

    # At one turn in an hour only the news can have woken it.
    driver = RobotDriver(Bell(), robot_id=0, limits=FAST, rate_hz=1 / 3600, hold_s=60)
    with driver:
        driver.send_motion(Motion(0.1, 0.0))
        assert came.wait(10)


def test_a_team_s_command_without_the_robot_is_refused(rig) -> None:
    driver, _, _ = rig
    for ids in ([1, 2], [1, 5], [4, 5]):
        with pytest.raises(MessageError, match="expected 3 among them"):
            driver.send(VelocityCommand(ids, [1.0, 1.0], [0, 0]))


def test_flight_in_the_body_s_frame(rig) -> None:
    driver, wire, steps = rig
    driver.flies = True
    # Towards the right of the image is to the right, and towards its top is ahead.
    driver.send_flight(FlightCommand(3, np.array([0.5, -2.0]), climb_mps=1.0, yaw_rate_radps=0.25))
    steps.round()
    assert wire.written[-1] == Motion(2.0, 0.25, left_mps=-0.5, up_mps=1.0, flies=True)


def test_all_that_a_flying_unit_is_sent_says_so(rig) -> None:
    """Straight ahead, and when its command is old: what a robot on wheels would be sent two speeds for."""
    driver, wire, steps = rig
    driver.flies = True
    driver.send_flight(FlightCommand(3, np.array([0.0, -1.0]), climb_mps=0.0, yaw_rate_radps=0.0))
    for _ in range(5):
        steps.round()
    assert Motion(1.0, 0.0, flies=True) in wire.written
    assert wire.written[-1] == Motion(0.0, 0.0, flies=True)
    assert {motion.flies for motion in wire.written[1:]} == {True}


def test_wheels_take_no_flight_command(rig) -> None:
    with pytest.raises(InputError, match="a flight command for wheels"):
        rig[0].send_flight(FlightCommand.hold(3))


def test_a_dry_run_says_what_changes(capsys) -> None:
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


def test_a_link_of_one_s_own(tmp_path, monkeypatch) -> None:
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
def test_an_address_that_means_nothing_is_one_clear_line(address, words) -> None:
    pytest.importorskip("serial")
    pytest.importorskip("paho.mqtt")
    with pytest.raises(InputError, match=words) as raised:
        open_driver(address, robot_id=0)
    assert "\n" not in str(raised.value) and "secret" not in str(raised.value)


@pytest.mark.parametrize("numbers", [{"rate_hz": 0.0}, {"hold_s": float("nan")}, {"hold_s": -1.0}])
def test_rate_and_hold_are_checked(numbers) -> None:
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
def test_what_is_missing_is_named(address, module, package, monkeypatch) -> None:
    monkeypatch.setitem(__import__("sys").modules, module, None)
    with pytest.raises(InputError, match=f"{package} is not installed; pip install 'skyherd\\[live\\]'"):
        open_driver(address, robot_id=0)
