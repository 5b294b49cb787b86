"""A robot's process: goals in, wheel commands out, by a driver."""

import time
from contextlib import ExitStack

import numpy as np

from skyherd.live.drivers import WORLD, Motion, RobotDriver, open_driver
from skyherd.live.radio import Arrival, Post
from skyherd.live.robot_core import Order
from skyherd.live.station import Beats, Station, Told
from skyherd.live.wire import Wheels
from skyherd.messages import MotionGoals, VelocityCommand

HEARS = ("goals/**", "proximity/**", "sighting/**", "beat/unit/*", "arm/**", "stop/**")
"""Topics that a robot listens to, after the team's name."""

LEAST_SHARE = 0.2
"""Share of a period that a robot lets pass between two decisions at least. Chosen: goals of several units
come one after the other, and each is decided on at once or a few hundredths of a second later; a tenth would
have a robot under many cameras do little else."""


class Pace:
    """When a robot decides: once a period, and as soon as there are news, but not much more often.

    Attributes:
        due_s: when it decides the next time.

    Args:
        period_s: longest time between two decisions.
        now_s: now, by any clock that runs steadily.
    """

    def __init__(self, period_s: float, now_s: float) -> None:
        self.due_s = self._decided_s = now_s
        self._period_s = period_s

    def hear(self, arrival: Arrival, robot_id: int, now_s: float) -> None:
        """A message arrived: a goal for this robot is worth a decision of its own."""
        message = arrival.envelope.message
        if isinstance(message, MotionGoals) and robot_id in message.ids:
            soonest_s = self._decided_s + LEAST_SHARE * self._period_s
            self.due_s = min(self.due_s, max(now_s, soonest_s))

    def decided(self, now_s: float) -> None:
        """The robot has decided."""
        self._decided_s = now_s
        self.due_s = max(self.due_s + self._period_s, now_s)


class WorldWheels:
    """A link to the wheels of a simulated robot."""

    def __init__(self, post: Post, robot_id: int) -> None:
        self.name, self._post, self._robot_id = "world", post, robot_id

    def write(self, motion: Motion) -> None:
        """Send it to the world."""
        self._post.send(Wheels(self._robot_id, motion.forward_mps, motion.turn_radps))

    def close(self) -> None:
        """Nothing is open."""


def run_robot(station: Station, robot_id: int, *, dry_run: bool = False) -> None:
    """Be one robot until `station.ended`; wheels are told to stand still on the way out, whatever happens.

    Args:
        station: what the process has.
        robot_id: the robot's marker.
        dry_run: print commands in place of sending them.
    """
    lab, clock = station.lab, station.clock
    core = lab.make_robot(robot_id)
    post = station.post(core.name, HEARS)
    with ExitStack() as stack:
        diary = stack.enter_context(station.diary(core.name))
        driver = stack.enter_context(_driver(station, post, robot_id, dry_run=dry_run))
        told = Told(station, diary)
        beats = Beats()
        pace = Pace(lab.model.limits.period_s, time.monotonic())
        while not station.ended():
            while (left_s := pace.due_s - time.monotonic()) > 0:
                for arrival in post.fetch(left_s):
                    diary.heard(arrival)
                    core.receive(arrival.envelope, arrival.received_s)
                    pace.hear(arrival, robot_id, time.monotonic())
            pace.decided(time.monotonic())
            now_s = clock()
            order = core.decide(now_s)
            driver.send(
                VelocityCommand(np.array([robot_id]), np.array([order.v_mps]), np.array([order.omega_radps]))
            )
            news = {"order": order, "armed": core.armed, "image_age_s": core.image_age_s(now_s)}
            diary.put("/decide", now_s, news)
            told.say(_line(core.name, order, driver.trouble or diary.trouble))
            if beats.due(now_s):
                post.send(core.beat(now_s, order.reason))
                diary.put("/beat", now_s, {"refused": post.refusals.counts, "dropped": post.dropped})
        diary.put("/end", clock(), {})


def _line(name: str, order: Order, trouble: str | None) -> str:
    """What a robot says to people when it changes."""
    return f"{name}: {order.reason}{f'; {trouble}' if trouble else ''}"


def _driver(station: Station, post: Post, robot_id: int, *, dry_run: bool) -> RobotDriver:
    lab = station.lab
    address = "dry-run" if dry_run else lab.robot(robot_id).driver
    if address == WORLD:
        return RobotDriver(WorldWheels(post, robot_id), robot_id=robot_id, limits=lab.speed_limits)
    return open_driver(address, robot_id=robot_id, limits=lab.speed_limits)
