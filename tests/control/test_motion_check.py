"""A robot that moves otherwise than told is detected, and none that follows its commands.

An independent simulation drives robots to random places by what one camera sees of their markers. The check
knows the commands alone, and the robots differ from them as real ones do.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
import pytest

from skyherd.control import LatencyCompensation
from skyherd.control.robots.motion_check import (
    LAGS_S,
    MIN_STEPS,
    STANDS,
    STEP_S,
    STRAYS,
    MotionCheck,
    SeenPose,
)
from skyherd.messages import VelocityCommand

STEP, SIDE_M, PX_PER_M = 0.05, 0.08, 400.0
LIMITS = np.array([0.2, 1.5])
CHECK_LIMITS = LIMITS / (SIDE_M, 1.0)


@dataclass(frozen=True)
class Robot:
    """Differences of a robot and its camera from what the robot's commands say.

    Attributes:
        speed: actual over commanded speed.
        turn: actual over commanded turn rate.
        lag_s: latency of the drive.
        rise_s: time constant of the drive.
        dead: share of the limits up to which commands have no effect.
        slip: standard deviation of the speeds, as a share.
        mount_rad: turn of the marker on the robot.
        tilt_rad: tilt of the camera, which compresses its v axis.
        noise_sides: standard deviation of the marker's centre.
        sway_m: standard deviation of the camera's displacement between two steps.
        flies: whether the check knows that the unit flies.
        stays: whether it stays at its first goal.
    """

    speed: float = 1.0
    turn: float = 1.0
    lag_s: float = 0.1
    rise_s: float = 0.15
    dead: float = 0.0
    slip: float = 0.0
    mount_rad: float = 0.0
    tilt_rad: float = 0.0
    noise_sides: float = 0.003
    sway_m: float = 0.0
    flies: bool = False
    stays: bool = False

    def new_check(self) -> MotionCheck:
        return MotionCheck(CHECK_LIMITS, is_fixed=not self.flies)


class Body:
    """A robot with its marker, and one camera."""

    def __init__(self, robot: Robot, rng: np.random.Generator) -> None:
        self.robot, self._rng = robot, rng
        self._place, self._sway, self._actual = np.zeros(2), np.zeros(2), np.zeros(2)
        self._heading = rng.uniform(-np.pi, np.pi)
        self._orders = [np.zeros(2)] * round(robot.lag_s / STEP + 1)
        self._flatten = np.array([1, -np.cos(robot.tilt_rad)])  # v points down
        self.side_px = PX_PER_M * SIDE_M * np.cos(robot.tilt_rad) ** 0.5

    def to_image(self, point_m: np.ndarray) -> complex:
        """Return the image point of a point on the ground."""
        return complex(*(point_m * PX_PER_M * self._flatten))

    def seen(self) -> tuple[complex, float]:
        """Return centre and heading of the marker in an image."""
        noise = self.robot.noise_sides * self._rng.normal(size=3)
        center = self.to_image(self._place + self._sway) + self.side_px * complex(*noise[:2])
        ahead = self._heading + self.robot.mount_rad
        return center, np.angle(self.to_image(np.array([np.cos(ahead), np.sin(ahead)]))) + 2 * noise[2]

    def move(self, command: np.ndarray) -> None:
        """Drive for a step after a command (2,), speed and turn rate."""
        robot = self.robot
        self._orders = [*self._orders[1:], command]
        works = np.abs(self._orders[0]) >= robot.dead * LIMITS
        told = np.where(works, self._orders[0], 0.0) * (robot.speed, robot.turn)
        self._actual = self._actual + STEP / max(robot.rise_s, STEP) * (told - self._actual)
        moved = self._actual * STEP * (1 + robot.slip * self._rng.normal(size=2))
        self._place = self._place + moved[0] * np.array([np.cos(self._heading), np.sin(self._heading)])
        self._heading += moved[1]
        self._sway = self._sway + robot.sway_m * self._rng.normal(size=2)


class Pilot:
    """The commands of one robot, by the marker that it takes for its own."""

    def __init__(self, marked: Body, rng: np.random.Generator) -> None:
        self._marked, self._rng, self._goal_m = marked, rng, rng.normal(size=2)
        self._reckoning = LatencyCompensation(1, SIDE_M, memory_s=2.0)
        self.command = np.zeros(2)

    def see(self, time_s: float) -> SeenPose:
        """Take an image, decide, and return the pose of the marker with the commanded ones."""
        center, heading = self._marked.seen()
        places_m, headings_rad = self._reckoning.marker_poses(time_s - np.array(LAGS_S))
        side_px = self._marked.side_px
        way = (self._marked.to_image(self._goal_m) - center) * np.exp(-1j * heading) / side_px * SIDE_M
        if abs(way) < 0.05 and not self._marked.robot.stays:
            self._goal_m = self._rng.normal(size=2)
        bearing = -np.angle(way)
        drives = abs(way) > 0.05 * SIDE_M
        self.command = np.clip([0.3 * abs(way) * np.cos(bearing), 1.2 * bearing], -LIMITS, LIMITS) * drives
        return SeenPose(time_s, center, heading, side_px, places_m[:, 0] / SIDE_M, headings_rad[:, 0])

    def record(self, time_s: float) -> None:
        """Record that the command is sent."""
        self._reckoning.record(VelocityCommand([0], self.command[:1], self.command[1:]), time_s)


def drive(
    robots: Sequence[Robot], rng: np.random.Generator, duration_s: float
) -> Iterator[tuple[SeenPose, ...]]:
    """Drive to random places, and yield the markers' poses in the images of a camera with 5 images/s.

    The commands of each robot go to the wheels of the next one, and those of the last to the first.
    """
    bodies = [Body(robot, rng) for robot in robots]
    pilots = [Pilot(body, rng) for body in bodies]
    for step in range(round(duration_s / STEP)):
        if step % 4 == 0:
            yield tuple(pilot.see(step * STEP) for pilot in pilots)
        for pilot, body in zip(pilots, [*bodies[1:], bodies[0]], strict=True):
            pilot.record(step * STEP)
            body.move(pilot.command)


def drive_alone(robot: Robot, seed: int, duration_s: float) -> Iterator[SeenPose]:
    """Drive one robot by its own commands."""
    return (pose for (pose,) in drive([robot], np.random.default_rng(seed), duration_s))


FOLLOWING = {
    "exact": Robot(lag_s=0.0, rise_s=0.0, noise_sides=0.0),
    "latency of 0.3 s": Robot(lag_s=0.3),
    "latency of 0.5 s": Robot(lag_s=0.5),
    "half as fast": Robot(speed=0.5, turn=0.5),
    "twice as fast": Robot(speed=2.0, turn=2.0),
    "slow, and turns fast": Robot(speed=0.3, turn=2.0),
    "fast, and turns slowly": Robot(speed=2.0, turn=0.3),
    "slipping": Robot(slip=0.5),
    "dead zone": Robot(dead=0.2),
    "turned marker": Robot(mount_rad=np.radians(30)),
    "tilted camera": Robot(tilt_rad=np.radians(50)),
    "noise": Robot(noise_sides=0.05),
    "at its goal": Robot(stays=True),
    "at its goal, with noise": Robot(stays=True, noise_sides=0.05, lag_s=0.3),
    "flying unit": Robot(sway_m=0.01, flies=True),
}


@pytest.mark.parametrize("robot", FOLLOWING.values(), ids=FOLLOWING)
@pytest.mark.parametrize("seed", range(3))
def test_robots_that_follow_raise_no_alarm(robot, seed) -> None:
    """Ten minutes in all, with a judgement every second."""
    check = robot.new_check()
    assert not any(check.look(pose) for pose in drive_alone(robot, seed, 200.0))


@pytest.mark.slow
@pytest.mark.parametrize("robot", FOLLOWING.values(), ids=FOLLOWING)
def test_half_an_hour_of_driving_raises_no_alarm(robot) -> None:
    check = robot.new_check()
    assert not any(check.look(pose) for pose in drive_alone(robot, 700, 1800.0))


WRONG = {
    "both wheels reversed": (Robot(speed=-1.0, turn=-1.0), STRAYS),
    "drives backwards": (Robot(speed=-1.0), STRAYS),
    "marker turned by 90 degrees": (Robot(mount_rad=np.pi / 2), STRAYS),
    "marker turned by 180 degrees": (Robot(mount_rad=np.pi), STRAYS),
    "stands still": (Robot(speed=0.0, turn=0.0), STANDS),
}


@pytest.mark.parametrize(("robot", "fault"), WRONG.values(), ids=WRONG)
@pytest.mark.parametrize("seed", range(5))
def test_wrong_robots_are_found_within_five_steps(robot, fault, seed) -> None:
    check = robot.new_check()
    found = next(
        (pose.time_s, found) for pose in drive_alone(robot, seed, 30.0) if (found := check.look(pose))
    )
    assert found[1] == fault and MIN_STEPS * STEP_S <= found[0] + 1e-9 <= 5 * STEP_S


def test_exchanged_robots_are_found() -> None:
    """Each of two robots drives by the commands of the other one, until one of them is found."""
    found_s = []
    for seed in range(20):
        checks = Robot().new_check(), Robot().new_check()
        scene = drive([Robot(), Robot()], np.random.default_rng(seed), 60.0)
        found_s.append(
            next(
                poses[0].time_s
                for poses in scene
                if STRAYS in [check.look(pose) for check, pose in zip(checks, poses, strict=True)]
            )
        )
    assert np.median(found_s) <= 5 * STEP_S and max(found_s) <= 30.0, found_s


def test_turn_alone_reveals_reversed_turning_to_flying_units() -> None:
    """The law drives backwards too, so that such a robot may reach some goals before it has to turn."""
    robot = Robot(turn=-1.0, flies=True, sway_m=0.01)
    for seed in range(10):
        check = robot.new_check()
        assert any(check.look(pose) for pose in drive_alone(robot, seed, 60.0))


def test_flying_unit_ignores_its_own_displacement() -> None:
    """The negative control of `is_fixed`: the same camera, taken as fixed, accuses the robot."""
    swaying = Robot(sway_m=0.05, flies=True)
    poses = list(drive_alone(swaying, 0, 60.0))
    slow = [replace(pose, center_px=0.1 * pose.center_px) for pose in poses]
    check, fixed = swaying.new_check(), replace(swaying, flies=False).new_check()
    assert not any(check.look(pose) for pose in slow)
    assert any(fixed.look(pose) for pose in slow)


def test_carried_robot_and_misread_marker_raise_no_alarm() -> None:
    """A hand carries the robot by 3 m/s, and one image shows its marker elsewhere."""
    poses = list(drive_alone(Robot(), 1, 60.0))
    carried = [
        replace(pose, center_px=pose.center_px + PX_PER_M * min(max(pose.time_s - 20.0, 0.0), 2.0) * 3.0)
        for pose in poses
    ]
    carried[50] = replace(carried[50], center_px=carried[50].center_px + 1000.0)
    check = Robot().new_check()
    assert not any(check.look(pose) for pose in carried)


def test_images_out_of_order_are_ignored() -> None:
    """Two units' radios repeat old messages; the check of a wrong robot goes on."""
    wrong = Robot(speed=-1.0, turn=-1.0)
    poses = list(drive_alone(wrong, 2, 30.0))
    check, repeated = wrong.new_check(), wrong.new_check()
    faults = [check.look(pose) for pose in poses]
    for row, pose in enumerate(poses):
        assert repeated.look(pose) == faults[row]
        assert repeated.look(poses[max(row - 8, 0)]) == ""
    assert STRAYS in faults
