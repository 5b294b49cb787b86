"""The robots' memory of nearby bodies: position, time of the image, and own rotation since."""

from collections import deque

import numpy as np

from skyherd.control.robots.latency_compensation import LatencyCompensation
from skyherd.geometry import Array, BoolArray, IntArray, wrap_angle
from skyherd.messages import BORDER_IDS, TIME_TOLERANCE_S, Proximity, find_rows
from skyherd.messages.checks import check_ids


class NeighborMemory:
    """Newest message about each pair of a robot and another body, as arrays over N robots and M bodies.

    The bodies include the four sides of an image, from the newest message that contains the robot.

    A robot has no compass, but it knows its commanded turn rates. Directions are stored in the frame of the
    robot at the start of the run. They therefore remain valid while it turns. Robots that decide at equal
    time steps call `record_rotation` at each. Others pass `latency_compensation`, which has the times.

    Attributes:
        ids: (N,) the robots, ascending.
        other_ids: (M,) sides of the image, robots and obstacles, ascending.
        lifetime_s: age at which a message is stale.
        distances_sides: (N, M) distances between centres at the time of the image.
        reaches_sides: (N, M) distances between centres at which the two bodies touch.
        shares: (N, M) share of the gap that the robot may use up.
        directions_rad: (N, M) directions to the other body in the frame of each robot at the start.
        imaged_s: (N, M) time of the image; -inf if unknown, or if the two are far apart.
        horizon_sides: (N,) bodies that were not reported were farther away than this.
        seen_s: (N,) time of the newest image with the robot whose message it received; -inf if none.

    Args:
        ids: as the attribute.
        other_ids: (M - 4,) robots and obstacles, ascending.
        lifetime_s: as the attribute.
        latency_compensation: the robots' headings, from the commands that their wheels received; None if
            `record_rotation` is called at equal time steps instead.
    """

    def __init__(
        self,
        ids: IntArray,
        other_ids: IntArray,
        lifetime_s: float,
        latency_compensation: LatencyCompensation | None = None,
    ) -> None:
        ids = check_ids(ids, "NeighborMemory.ids")
        other_ids = check_ids(other_ids, "NeighborMemory.other_ids")
        self.ids, self.lifetime_s = ids, lifetime_s
        self._latency_compensation = latency_compensation
        self.other_ids: IntArray = np.concatenate([BORDER_IDS, other_ids])
        shape = ids.size, self.other_ids.size
        self.distances_sides: Array = np.zeros(shape)
        self.reaches_sides: Array = np.zeros(shape)
        self.shares: Array = np.ones(shape)
        self.directions_rad: Array = np.zeros(shape)
        self.imaged_s: Array = np.full(shape, -np.inf)
        self.horizon_sides: Array = np.zeros(ids.size)
        self.seen_s: Array = np.full(ids.size, -np.inf)
        self._rotation_rad: Array = np.zeros(ids.size)
        self._rotations: deque[tuple[float, Array]] = deque()

    def receive(
        self, message: Proximity, received: BoolArray | None = None, lead_s: Array | None = None
    ) -> None:
        """Store the message of one unit, unless a newer image of the same pair is known.

        Pairs that the message omits, although it contains both bodies, are far apart and are removed.

        Args:
            message: bodies near the robots of one image.
            received: (N,) mask of the message's `ids` that received it; all if None.
            lead_s: (N,) each robot's estimate of the lead of the stamping clock over its own clock; 0 if
                None.
        """
        arrived = np.ones(len(message), dtype=bool) if received is None else received
        rows, is_robot = find_rows(self.ids, message.ids)
        columns, is_body = find_rows(self.other_ids, np.concatenate([BORDER_IDS, message.ids]))
        rows, columns = rows[arrived & is_robot], columns[is_body]
        now = rows[self.seen_s[rows] <= message.time_s]
        self.seen_s[now], self.horizon_sides[now] = message.time_s, message.horizon_sides
        block = np.ix_(rows, columns)
        before_s = self.imaged_s[block]
        self.imaged_s[block] = np.where(before_s <= message.time_s, -np.inf, before_s)
        hears = np.zeros(self.ids.size, dtype=bool)
        hears[rows] = True
        robot, is_robot = find_rows(self.ids, message.robot_ids)
        other, is_body = find_rows(self.other_ids, message.other_ids)
        newer = self.imaged_s[robot, other] <= message.time_s
        row = np.flatnonzero(is_robot & hears[robot] & is_body & newer)
        pair = robot[row], other[row]
        self.distances_sides[pair] = message.distances_sides[row]
        self.reaches_sides[pair] = message.reaches_sides[row]
        self.shares[pair] = message.shares[row]
        self.directions_rad[pair] = message.bearings_rad[row] + self._rotation_at(
            message.time_s - (np.zeros(self.ids.size) if lead_s is None else lead_s)[pair[0]], pair[0]
        )
        self.imaged_s[pair] = message.time_s

    def fresh(self, time_s: Array | float) -> tuple[IntArray, IntArray]:
        """Return rows (P,) and columns (P,) of the pairs that are not stale at the time or times (N,)."""
        oldest_s = np.broadcast_to(time_s, self.ids.shape)[:, None] - self.lifetime_s - TIME_TOLERANCE_S
        row, column = np.nonzero(self.imaged_s >= oldest_s)
        return row.astype(np.int64), column.astype(np.int64)

    def bearings_rad(self, pair: tuple[IntArray, IntArray], time_s: Array | float) -> Array:
        """Return bearings (P,) of the other bodies in the robots' frames at `time_s`, positive to the left.

        Args:
            pair: rows (P,) and columns (P,).
            time_s: now, or the robots' times (N,). Unused without `latency_compensation`, where the last step
                counts.
        """
        turned_rad = self._rotation_rad[pair[0]]
        if self._latency_compensation is not None:
            turned_rad = self._rotation_at(np.broadcast_to(time_s, self.ids.shape)[pair[0]], pair[0])
        return wrap_angle(self.directions_rad[pair] - turned_rad)

    def record_rotation(self, omega_radps: Array, time_s: float, step_s: float) -> None:
        """Record the turn rates (N,), rad/s, commanded from `time_s` on for `step_s`.

        With `latency_compensation` it does nothing.
        """
        if self._latency_compensation is not None:
            return
        self._rotations.append((time_s, self._rotation_rad))
        while self._rotations[0][0] < time_s - self.lifetime_s:
            self._rotations.popleft()
        self._rotation_rad = self._rotation_rad + omega_radps * step_s

    def _rotation_at(self, times_s: Array, robots: IntArray) -> Array:
        """Return angles (P,), rad, that robots (P,) had turned since the start at past times (P,)."""
        if self._latency_compensation is not None:
            return self._latency_compensation.headings_rad(times_s, robots)
        knots_s = [at for at, _ in self._rotations]
        rotations = np.array([*(turned for _, turned in self._rotations), self._rotation_rad])
        return np.asarray(rotations[np.searchsorted(knots_s, times_s - TIME_TOLERANCE_S), robots])
