"""Process of a robot: goals in, wheel commands out through a driver."""

import time
from contextlib import ExitStack

import numpy as np

from skyherd.live.drivers import DRY_RUN, WORLD, Motion, RobotDriver, open_driver
from skyherd.live.mailbox import Arrival, Mailbox
from skyherd.live.process_context import HeartbeatTimer, ProcessContext, StatusLine
from skyherd.live.robot_core import DRIVING, Order
from skyherd.live.wire import SESSION, Stop, Wheels
from skyherd.messages import MotionGoals, VelocityCommand

HEARS = (
    "goals/**",
    "proximity/**",
    "sighting/**",
    "heartbeat/unit/*",
    f"heartbeat/{SESSION}",
    "arm/**",
    "stop/**",
)
"""Topics that a robot listens to, after the team's name, besides heartbeats under its own name."""

MIN_SHARE = 0.2
"""Shortest time between two decisions, as a share of the period. Chosen: goals of several units arrive in
bursts. At 0.1, decisions would occupy a robot under many cameras."""


DRY_RUN_NOTE = " (dry run)"
"""Suffix of the state in the heartbeats of a robot without wheels, which units do not expect to move."""


class DecisionTimer:
    """Timer of a robot's decisions: once a period, soon after each new goal, and at once after a stop.

    Attributes:
        due_s: time of the next decision.

    Args:
        period_s: longest time between two decisions.
        now_s: current time on any monotonic clock.
    """

    def __init__(self, period_s: float, now_s: float) -> None:
        self.due_s = self._decided_s = now_s
        self._period_s = period_s

    def hear(self, arrival: Arrival, robot_id: int, now_s: float) -> None:
        """Advance the next decision if the message is a goal for this robot or a stop."""
        message = arrival.envelope.message
        if isinstance(message, Stop):
            self.hasten(now_s)
        elif isinstance(message, MotionGoals) and robot_id in message.ids:
            soonest_s = self._decided_s + MIN_SHARE * self._period_s
            self.due_s = min(self.due_s, max(now_s, soonest_s))

    def hasten(self, now_s: float) -> None:
        """Let the next decision be due now."""
        self.due_s = min(self.due_s, now_s)

    def decided(self, now_s: float) -> None:
        """Schedule the next decision after a decision made now."""
        self._decided_s = now_s
        self.due_s = max(self.due_s + self._period_s, now_s)


class WorldWheels:
    """Link to the wheels of a simulated robot."""

    def __init__(self, mailbox: Mailbox, robot_id: int) -> None:
        self.name, self._mailbox, self._robot_id = "world", mailbox, robot_id

    def write(self, motion: Motion) -> None:
        """Send a motion to the simulated world."""
        self._mailbox.send(Wheels(self._robot_id, motion.forward_mps, motion.turn_radps))

    def close(self) -> None:
        """Do nothing: the mailbox belongs to the process."""


def run_robot(context: ProcessContext, robot_id: int) -> None:
    """Run one robot until `context.ended()`. The wheels stop at the end, also after an error.

    Args:
        context: resources of the process.
        robot_id: id of the robot's marker.
    """
    lab, clock = context.lab, context.clock
    core = lab.make_robot(robot_id, supervised=context.supervised, dry_run=context.dry_run)
    mailbox = context.mailbox(core.name, (*HEARS, f"heartbeat/{core.name}"), lambda: core.latch)
    with ExitStack() as stack:
        process_log = stack.enter_context(context.process_log(core.name))
        driver = stack.enter_context(_driver(context, mailbox, robot_id))
        status = StatusLine(context, process_log)
        note = DRY_RUN_NOTE if context.dry_run or lab.robot(robot_id).driver == DRY_RUN else ""
        heartbeats = HeartbeatTimer()
        timer = DecisionTimer(lab.model.limits.period_s, time.monotonic())
        while not context.ended():
            while (left_s := timer.due_s - time.monotonic()) > 0:
                was_armed = core.armed
                for arrival in mailbox.fetch(left_s):
                    process_log.heard(arrival)
                    core.receive(arrival.envelope, arrival.received_s)
                    timer.hear(arrival, robot_id, time.monotonic())
                if was_armed and not core.armed:  # Any message may carry the number of a stop.
                    timer.hasten(time.monotonic())
            timer.decided(time.monotonic())
            now_s = clock()
            trouble = driver.trouble
            order = core.decide(now_s, trouble)
            driver.send(_command(robot_id, order), stop=core.latch.stop)
            news = {"order": order, "armed": core.armed, "image_age_s": core.image_age_s(now_s)}
            process_log.put("/decide", now_s, news | {"trouble": trouble})
            state = _state(order, trouble)
            status.say("; ".join(filter(None, (f"{core.name}: {state}", process_log.trouble))))
            if heartbeats.due(now_s):
                mailbox.send(core.heartbeat(now_s, state + note, driver.halted))
                process_log.put(
                    "/heartbeat", now_s, {"refused": mailbox.refusals.counts, "dropped": mailbox.dropped}
                )
        process_log.put("/end", clock(), {})


def _command(robot_id: int, order: Order) -> VelocityCommand:
    """Return the command of one robot."""
    return VelocityCommand(np.array([robot_id]), np.array([order.v_mps]), np.array([order.omega_radps]))


def _state(order: Order, trouble: str | None) -> str:
    """Return the state of a robot, as a text: with trouble of its link it does not count as driving."""
    reason = "" if trouble and order.reason in (DRIVING, trouble) else order.reason
    return "; ".join(filter(None, (reason, trouble)))


def _driver(context: ProcessContext, mailbox: Mailbox, robot_id: int) -> RobotDriver:
    lab = context.lab
    address = DRY_RUN if context.dry_run else lab.robot(robot_id).driver
    if address == WORLD:
        return RobotDriver(WorldWheels(mailbox, robot_id), robot_id=robot_id, limits=lab.speed_limits)
    return open_driver(address, robot_id=robot_id, limits=lab.speed_limits)
