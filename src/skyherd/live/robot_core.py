"""Decisions of one robot without I/O: messages and clock readings in, wheel speeds out.

The control law is the simulator's (`GoalFollowers`, a team of one), and the safety rules surround it. Wheels
turn only while all of these conditions hold. The robot reports the first condition that fails:

- no stop is in force, and an arm command armed the robot for its current session (`skyherd.live.stop_latch`);
- no other process uses the robot's name;
- if a session (`skyherd live run`) runs the robot, a heartbeat of it was heard within `SESSION_SILENCE_S`.
  Otherwise the robot is disarmed, and stays so when the session goes on;
- the robot's clock is monotonic, without a gap between two decisions;
- its marker moves in the images as its wheels were told (`skyherd.control.robots.motion_check`). Otherwise
  the robot is disarmed;
- a goal is fresh: its image is at most `goal_timeout_s` old, by compared clocks. This is the watchdog against
  stale goals;
- a unit saw the robot's marker within `unseen_s`, and no unit has seen it at two places since;
- a unit sent a message after the robot's process started or woke up. It carries the stop number;
- the link to the wheels takes commands. After `MAX_TROUBLE_S` without, the robot is disarmed.

Speeds stay within the limits for any input, and their magnitude grows no faster than the acceleration limits.
Stopping is not limited: the command is zero at once, and the drive brakes.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from skyherd.control import (
    AvoidanceRule,
    GoalFollowers,
    GoalInboxes,
    LatencyCompensation,
    MotionChecks,
    NeighborMemory,
    RobotLaw,
    Wheels,
)
from skyherd.live.drivers.driver import HOLD_S
from skyherd.live.drivers.limits import Limiter, SpeedLimits
from skyherd.live.drivers.link import STILL, Motion
from skyherd.live.peers import CONFLICT_S, ClockLimits, PeerClocks
from skyherd.live.stop_latch import NOT_HALTED, ArmState, StopLatch
from skyherd.live.wire import SESSION, Arm, Envelope, Heartbeat, Stop
from skyherd.messages import MotionGoals, Proximity, Sighting, VelocityCommand
from skyherd.messages.checks import check_numbers

FUTURE_S = 0.05
"""Largest apparent lead of an image over now, beyond the clocks' uncertainty, s. Chosen: below the frame
interval, and above the change of an offset estimate between two messages."""

MAX_GAP_S = 1.0
"""Longest time between two decisions without suspecting a sleep or a set clock, s. Chosen: ten periods, and
above the scheduling delays of a busy machine."""

MAX_TROUBLE_S = 1.0
"""Time of trouble with the link after which the robot is disarmed, s. Chosen: one lost line disarms no robot,
and a cable that is plugged in by hand takes longer."""

DRIVING = "driving"
"""Reason reported while nothing stops the robot."""

SESSION_SILENCE_S = 2.0
"""Silence of the session, s, after which its robots are disarmed. Chosen: eight heartbeats. An operator whose
`live run` is suspended or hangs has no stop button."""

NO_SESSION = "`live run` is silent: suspended or hanging?"
"""Reason reported while the session that runs the robot is silent."""

UNSEEN = "no unit sees its marker"
"""Reason reported while the robot is outside all images."""


@dataclass(frozen=True)
class RobotLimits:
    """Limits and watchdog timeouts of a robot.

    Attributes:
        speeds: limits of speed, turn rate and acceleration.
        goal_timeout_s: age of an image, on the robot's clock, above which its goal is stale.
        unseen_s: time without a sighting after which the marker counts as outside all images.
    """

    speeds: SpeedLimits
    goal_timeout_s: float
    unseen_s: float

    def __post_init__(self) -> None:
        check_numbers(self, positive=("goal_timeout_s", "unseen_s"))


@dataclass(frozen=True)
class Order:
    """A wheel command with its reason.

    Attributes:
        v_mps: forward speed.
        omega_radps: turn rate.
        reason: `DRIVING`, or the reason why the robot stands still.
        wanted_v_mps: forward speed of the control law, before the safety rules.
        wanted_omega_radps: turn rate of the control law, before the safety rules.
    """

    v_mps: float
    omega_radps: float
    reason: str
    wanted_v_mps: float
    wanted_omega_radps: float


class RobotCore:
    """Decisions of one robot, from received messages to wheel commands.

    Decisions depend only on the calls, so that a replay of recorded calls reproduces them.

    Attributes:
        robot_id: id of its marker.
        clocks: estimated offsets of the other processes' clocks.

    Args:
        robot_id: as the attribute.
        unit_ids: the units that may send goals.
        law: control law with its gains.
        wheels: kinematics and limits of the drive.
        limits: speed limits and watchdog timeouts.
        side_m: side of its marker.
        delay_s: latency of the drive, from a command to its effect.
        clock_limits: limits of trust in another clock.
        other_ids: robots and obstacles to avoid; empty without avoidance.
        avoidance: rule of collision avoidance; None without avoidance.
        lab: digest of the lab file.
        supervised: whether a session runs the robot, which must not drive while that is silent.
        fixed_units: by unit whose images check the robot's motion, whether it does not fly; empty for no
            check.
    """

    def __init__(
        self,
        robot_id: int,
        unit_ids: list[int],
        law: RobotLaw,
        wheels: Wheels,
        limits: RobotLimits,
        *,
        side_m: float,
        delay_s: float,
        clock_limits: ClockLimits,
        other_ids: list[int] | None = None,
        avoidance: AvoidanceRule | None = None,
        lab: str = "",
        supervised: bool = False,
        fixed_units: Mapping[int, bool] | None = None,
    ) -> None:
        self.robot_id, self.name, self.limits = robot_id, f"robot/{robot_id}", limits
        self.clocks, self._lab = PeerClocks(self.name, clock_limits, lab), lab
        self._session_s = -math.inf if supervised else math.inf
        self._units = sorted(unit_ids)
        self._law, self._wheels, self._side_m, self._delay_s = law, wheels, side_m, delay_s
        self._avoidance, self._other_ids = avoidance, sorted(other_ids or [])
        self._arm_state = ArmState()
        self._started_s: float | None = None
        self._decided_s = math.nan
        self._woke_s, self._heard_since_woken = math.inf, False
        self._namesake_s = -math.inf
        self._seen_s: float
        self._doubled_s: float
        self._team: GoalFollowers
        self._limiter = Limiter(limits.speeds)
        self._refused = self._fault = ""
        self._fixed_units = fixed_units or {}
        self._trouble: str | None = None
        self._trouble_since_s = math.inf
        self._forget()

    @property
    def armed(self) -> bool:
        """True while an arm command is in force."""
        return self._arm_state.armed

    @property
    def latch(self) -> StopLatch:
        """Commands known to the robot."""
        return self._arm_state.latch

    @property
    def session(self) -> str:
        """Session that an arm command must name: start time, and number of times disarmed since."""
        return "" if self._started_s is None else f"{self._started_s:.6f}/{self._arm_state.disarmed_count}"

    def receive(self, envelope: Envelope, now_s: float) -> None:
        """Process a message that arrives now. No content raises an error."""
        message = envelope.message
        self._arm_state = self._arm_state.merge(envelope.latch)
        if isinstance(message, Stop):
            # A stop with an old number disarms too: its sender may not know the newest number yet.
            self._arm_state = self._arm_state.disarm()
            return
        if not math.isfinite(now_s):
            return
        if envelope.sender == self.name:
            self._namesake_s = now_s
            self._arm_state = self._arm_state.disarm()
            return
        self.clocks.hear(envelope, now_s)
        if envelope.sender == SESSION:
            self._session_s = max(self._session_s, now_s)
        if isinstance(message, Arm):
            if self.session and message.sessions.get(self.name) == self.session and self.is_ready(now_s):
                self._arm_state = self._arm_state.arm(envelope.latch.cleared)
                self._fault = ""
        elif isinstance(message, MotionGoals | Proximity | Sighting | Heartbeat):
            self._heard_since_woken |= self.clocks.was_sent_after(envelope, self._woke_s, now_s)
            if not isinstance(message, Heartbeat):
                self._hear_unit(message, envelope.sender, now_s)

    def is_ready(self, now_s: float) -> bool:
        """Return whether the robot accepts an arm command now."""
        is_sound = self._conflict(now_s) is None and self._trouble is None
        return is_sound and self._has_session(now_s) and self._is_seen(now_s)

    def heartbeat(self, now_s: float, state: str, halted: int = NOT_HALTED) -> Heartbeat:
        """Return the next heartbeat of this robot; `halted` is that of its driver."""
        heard, ready = self.clocks.heard(now_s), self.is_ready(now_s)
        return Heartbeat(heard, state, self.session, self.armed, ready, self._lab, halted)

    def image_age_s(self, now_s: float) -> float | None:
        """Return the age of the newest image with a goal, s, or None without a goal."""
        newest_s = float(self._team.inboxes.imaged_s.max())
        return now_s - newest_s if math.isfinite(newest_s) else None

    def decide(self, now_s: float, trouble: str | None = None) -> Order:
        """Return the next wheel command. Called periodically, also without new messages.

        Args:
            now_s: current time.
            trouble: reason why the link to the wheels takes no commands now, or None.
        """
        self._note_trouble(trouble, now_s)
        if not math.isfinite(now_s):
            return self._stopped("its own clock has no finite time")
        if self._started_s is None:
            self._started_s = self._woke_s = self._decided_s = now_s
        if not self._has_session(now_s):
            self._arm_state = self._arm_state.disarm()
        before_s, self._decided_s = self._decided_s, now_s
        if not 0 <= now_s - before_s <= MAX_GAP_S:
            was_doubled = before_s - self._doubled_s <= self.limits.unseen_s
            self._forget()
            self._doubled_s = now_s if was_doubled else self._doubled_s
            self._woke_s, self._heard_since_woken = now_s, False
            return self._stopped(f"its own clock jumped by {now_s - before_s:+.3g} s between two decisions")
        orders = self._team.decide(now_s, [])
        v_mps, omega_radps = float(orders.command.v_mps[0]), float(orders.command.omega_radps[0])
        if reason := self._stop_reason(now_s):
            return self._stopped(reason, v_mps, omega_radps, now_s)
        limited = self._limiter.limit(Motion(v_mps, omega_radps), now_s - before_s)
        self._record(limited, now_s)
        return Order(
            v_mps=limited.forward_mps,
            omega_radps=limited.turn_radps,
            reason=DRIVING,
            wanted_v_mps=v_mps,
            wanted_omega_radps=omega_radps,
        )

    def _stop_reason(self, now_s: float) -> str | None:
        """Return the reason why the robot must stand still, or None."""
        if self.latch.stopped:
            return "stopped"
        if conflict := self._conflict(now_s):
            return conflict
        if not self._has_session(now_s):
            return NO_SESSION
        if self._trouble is not None and now_s - self._trouble_since_s >= MAX_TROUBLE_S:
            return self._trouble
        if not self._team.inboxes.fresh(now_s).any():
            return self._refused or ("no fresh goal" if self._is_seen(now_s) else UNSEEN)
        if not self._is_seen(now_s):
            return UNSEEN
        if not self._heard_since_woken:
            return "no message from a unit since the process started or woke up"
        return None if self.armed else "; ".join(filter(None, ("disarmed", self._fault)))

    def _note_trouble(self, trouble: str | None, now_s: float) -> None:
        """Note the trouble of the link, and disarm after `MAX_TROUBLE_S` of it."""
        if trouble is None:
            self._trouble_since_s = math.inf
        elif self._trouble is None or not self._trouble_since_s <= now_s:
            self._trouble_since_s = now_s
        elif now_s - self._trouble_since_s >= MAX_TROUBLE_S:
            self._arm_state = self._arm_state.disarm()
        self._trouble = trouble

    def _conflict(self, now_s: float) -> str | None:
        """Return the reason why the robot's identity is ambiguous, or None."""
        if now_s - self._namesake_s <= CONFLICT_S:
            return f"another process is named {self.name}"
        if now_s - self._doubled_s <= self.limits.unseen_s:
            return "its marker is seen at two places"
        return None

    def _has_session(self, now_s: float) -> bool:
        """Return whether the session that runs the robot is alive; True without one."""
        return now_s - self._session_s <= SESSION_SILENCE_S

    def _is_seen(self, now_s: float) -> bool:
        """Return whether a unit saw the robot's marker recently."""
        return now_s - self._seen_s <= self.limits.unseen_s

    def _stopped(
        self, reason: str, v_mps: float = 0.0, omega_radps: float = 0.0, now_s: float | None = None
    ) -> Order:
        self._limiter.last = STILL
        if now_s is not None:
            self._record(STILL, now_s)
        return Order(
            v_mps=0.0, omega_radps=0.0, reason=reason, wanted_v_mps=v_mps, wanted_omega_radps=omega_radps
        )

    def _record(self, motion: Motion, now_s: float) -> None:
        """Record the command sent to the wheels, for latency compensation, instead of the law's command."""
        speeds = np.array([motion.forward_mps]), np.array([motion.turn_radps])
        self._motion.record(VelocityCommand(np.array([self.robot_id]), *speeds), now_s)

    def _hear_unit(self, message: MotionGoals | Proximity | Sighting, sender: str, now_s: float) -> None:
        """Process a message about an image, if the time of the image on our clock is known and plausible."""
        if message.unit_id not in self._units:
            self._refused = f"{sender} is not a unit of this team"
            return
        if why := self.clocks.distrust(sender, now_s):
            self._refused = why
            return
        known = self.clocks.estimate(sender, now_s)
        age_s = now_s - (message.time_s - known.offset_s)
        oldest_s = age_s + known.uncertainty_s
        if age_s < -known.uncertainty_s - FUTURE_S:
            self._refused = f"image of {sender} is {-age_s:.2g} s in the future"
            return
        if oldest_s > self.limits.goal_timeout_s:
            self._refused = f"stale image of {sender}: up to {oldest_s:.2g} s old"
            return
        self._refused = ""
        if isinstance(message, Sighting):
            if self.robot_id in message.repeated_ids:
                self._doubled_s = max(self._doubled_s, min(now_s, now_s - age_s))
            elif self.robot_id in message.ids:
                self._seen_s = max(self._seen_s, min(now_s, now_s - oldest_s))
                self._check_motion(message, now_s - age_s)
            return
        mine = np.asarray(message.ids == self.robot_id)
        if isinstance(message, MotionGoals):
            if mine.any():
                ours = self.clocks.in_our_time(message.take(mine), sender, now_s)
                self._team.inboxes.receive(ours, min(now_s, ours.time_s - known.uncertainty_s))
        elif self._team.neighbors is not None:
            self._team.neighbors.receive(self.clocks.in_our_time(message, sender, now_s), mine)

    def _check_motion(self, sighting: Sighting, taken_s: float) -> None:
        """Disarm the robot if its marker moves otherwise than its wheels were told since it was armed."""
        if not self.armed:
            self._motion_checks.reset()
        elif fault := self._motion_checks.look(sighting, taken_s):
            self._arm_state, self._fault = self._arm_state.disarm(), fault

    def _forget(self) -> None:
        """Reset goals, sightings and motion to the state after the start."""
        ids = np.array([self.robot_id])
        inboxes = GoalInboxes(
            ids, np.array(self._units), self.limits.goal_timeout_s, distances=self._law.needs_distances
        )
        self._motion = LatencyCompensation(
            1,
            self._side_m,
            axis_offset_m=self._wheels.axis_offset_m,
            delay_s=self._delay_s,
            memory_s=self.limits.goal_timeout_s + FUTURE_S + MotionChecks.MAX_LAG_S,
            hold_s=HOLD_S,
        )
        speeds = self.limits.speeds
        self._motion_checks = MotionChecks(
            self.robot_id,
            self._fixed_units,
            self._motion,
            max_speed_mps=speeds.speed_mps,
            max_turn_radps=speeds.turn_radps,
        )
        self._limiter.last = STILL
        self._seen_s = self._doubled_s = -math.inf
        neighbors = None
        if self._avoidance is not None:
            bodies = np.array(sorted({self.robot_id, *self._other_ids}))
            neighbors = NeighborMemory(
                ids,
                bodies,
                self._avoidance.lifetime_s,
                self._motion,
                max_speed_sides_ps=self._avoidance.wheels.max_speed_mps / self._side_m,
            )
        self._team = GoalFollowers(
            inboxes,
            self._law,
            self._wheels,
            neighbors=neighbors,
            avoidance=self._avoidance,
            latency_compensation=self._motion,
        )
