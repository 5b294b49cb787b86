"""Latency compensation: goals corrected by dead reckoning for the robot's motion since the image.

A goal is the vector from the robot's position at the time of the image to its desired point. Exposure,
detection, transmission and waiting delay it, and the robot moves meanwhile. The robot knows this motion
without any sensor, from its own commands. Subtracting it from the goal makes a delayed goal point to the same
place as a fresh one. Latency then no longer limits the gain. The robot's own marker relates metres to pixels:
its side is `side_m` metres and `side_px` pixels.
"""

from collections import deque
from copy import copy

import numpy as np

from skyherd.control.robots.goal_fusion import GoalInboxes
from skyherd.geometry import Array, ComplexArray, IntArray
from skyherd.messages import TIME_TOLERANCE_S, VelocityCommand
from skyherd.messages.checks import check_numbers


class LatencyCompensation:
    """Dead-reckoned poses of N robots, each from its own commands alone, in its frame at the start.

    Between two commands a robot drives an arc. With `h` the heading at the last command

        z(t) = z + v Δt sinc(ω Δt / 2) e^{i (h + ω Δt / 2)},   h(t) = h + ω Δt.

    Attributes:
        side_m: side of the robots' markers.
        axis_offset_m: distance by which a marker's centre lies ahead of the wheel axis.
        delay_s: actuation delay of a command, as the robots know it.
        memory_s: maximum age of stored poses; goals of older images are treated as having that age.
        hold_s: time for which wheels obey a command without a successor; then they stand still.

    Args:
        count: N.
        side_m: as the attribute.
        axis_offset_m: as the attribute.
        delay_s: as the attribute.
        memory_s: as the attribute.
        hold_s: as the attribute.

    Raises:
        InputError: a number is not finite or of the wrong sign.
    """

    def __init__(
        self,
        count: int,
        side_m: float,
        *,
        axis_offset_m: float = 0.0,
        delay_s: float = 0.0,
        memory_s: float,
        hold_s: float = np.inf,
    ) -> None:
        self.side_m, self.axis_offset_m = side_m, axis_offset_m
        self.delay_s, self.memory_s, self.hold_s = delay_s, memory_s, hold_s
        check_numbers(
            self,
            positive=("side_m", "memory_s"),
            not_negative=("delay_s",),
            finite=("axis_offset_m",),
        )
        still: Array = np.zeros(count)
        start: ComplexArray = np.zeros(count, dtype=np.complex128)
        self._knots: deque[tuple[float, ComplexArray, Array, Array, Array]] = deque(
            [(-np.inf, start, still, still, still)]
        )

    def record(self, command: VelocityCommand, time_s: float) -> None:
        """Record the wheel commands from `time_s` on; called in the order of time.

        Of two commands at one time the later one counts.
        """
        places_m, headings_rad = self._pose_after(len(self._knots) - 1, np.asarray(time_s))
        self._knots.append((time_s, places_m, headings_rad, command.v_mps, command.omega_radps))
        while len(self._knots) > 2 and self._knots[1][0] <= time_s - self.memory_s - self.delay_s:
            self._knots.popleft()

    def compensate(self, inboxes: GoalInboxes, time_s: float, lead_s: Array | float = 0.0) -> GoalInboxes:
        """Return the inboxes as if every image had been taken now, with goals in the robots' present frames.

        Let d be the motion of the marker of robot i since the image of unit j, and θ its turn, both in its
        frame at that time. Then `ρ' = (ρ - d side_px / side_m) e^{-iθ}`. With an actuation delay, "now" is
        the time at which a present command takes effect.

        Args:
            inboxes: received goals; not modified.
            time_s: present time.
            lead_s: (N,) each robot's estimate of the lead of the stamping clock over `time_s`.
        """
        moved_m, turned_rad = self._motion_since(inboxes.imaged_s - lead_s - self.delay_s, time_s)
        current = copy(inboxes)
        current.rho_px = (inboxes.rho_px - moved_m * (inboxes.sides_px / self.side_m)) * np.exp(
            -1j * turned_rad
        )
        return current

    def marker_poses(self, times_s: Array) -> tuple[ComplexArray, Array]:
        """Return marker places (T, N), m, and headings (T, N), rad, at which a camera sees the robots.

        Args:
            times_s: (T,) times of images. Those before the first remembered command count as its time.
        """
        robots = self._knots[0][1].size
        axles_m, headings_rad = self._poses_at(np.tile(times_s[:, None] - self.delay_s, robots))
        return axles_m + self.axis_offset_m * np.exp(1j * headings_rad), headings_rad

    def headings_rad(self, times_s: Array, robots: IntArray) -> Array:
        """Return the headings (P,), rad, of robots (P,), by row, at times (P,).

        After the last command it is taken to last on. Times before the first command that is remembered
        count as its time.
        """
        starts_s = np.array([knot[0] for knot in self._knots])
        when_s = np.maximum(times_s, starts_s[min(1, len(starts_s) - 1)])
        knots = np.searchsorted(starts_s, when_s + TIME_TOLERANCE_S, side="right") - 1
        headings_rad = np.zeros(times_s.shape)
        for knot in np.unique(knots).tolist():
            here = knots == knot
            start_s, _, then_rad, _, omega_radps = self._knots[knot]
            ran_s = 0.0 if start_s == -np.inf else np.clip(when_s[here] - start_s, 0.0, self.hold_s)
            headings_rad[here] = then_rad[robots[here]] + omega_radps[robots[here]] * ran_s
        return headings_rad

    def _motion_since(self, times_s: Array, now_s: float) -> tuple[ComplexArray, Array]:
        """Return marker motions (U, N), m, in the frames at `times_s` (U, N), and turns (U, N), rad."""
        place_m, heading_rad = self._pose_after(len(self._knots) - 1, np.asarray(now_s))
        places_m, headings_rad = self._poses_at(np.minimum(times_s, now_s))
        ahead = self.axis_offset_m
        moved = place_m + ahead * np.exp(1j * heading_rad) - places_m - ahead * np.exp(1j * headings_rad)
        return np.asarray(moved * np.exp(-1j * headings_rad)), np.asarray(heading_rad - headings_rad)

    def _poses_at(self, times_s: Array) -> tuple[ComplexArray, Array]:
        """Return positions (U, N), m, and headings (U, N), rad, of each robot at its times (U, N).

        Times before the first remembered command count as its time.
        """
        starts_s = np.array([knot[0] for knot in self._knots])
        when_s = np.maximum(times_s, starts_s[min(1, len(starts_s) - 1)])
        rows = np.searchsorted(starts_s, when_s + TIME_TOLERANCE_S, side="right") - 1
        places_m = np.zeros(times_s.shape, dtype=complex)
        headings_rad = np.zeros(times_s.shape)
        for row in np.unique(rows).tolist():
            there, then_rad = self._pose_after(row, when_s)
            places_m, headings_rad = (
                np.where(rows == row, there, places_m),
                np.where(rows == row, then_rad, headings_rad),
            )
        return places_m, headings_rad

    def _pose_after(self, row: int, times_s: Array) -> tuple[ComplexArray, Array]:
        """Return positions, m, and headings, rad, of all robots after a knot, under that knot's command."""
        start_s, places_m, headings_rad, v_mps, omega_radps = self._knots[row]
        if start_s == -np.inf:
            return places_m, headings_rad
        ran_s = np.clip(times_s - start_s, 0.0, self.hold_s)
        half_rad = omega_radps * ran_s / 2
        chord_m = v_mps * ran_s * np.sinc(half_rad / np.pi)
        return places_m + chord_m * np.exp(1j * (headings_rad + half_rad)), headings_rad + 2 * half_rad
