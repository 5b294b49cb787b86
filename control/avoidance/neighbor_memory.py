"""The robots' memory of nearby bodies: position, time of the image, and own rotation since."""

from collections import deque
from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from skyherd.control.robots.latency_compensation import LatencyCompensation
from skyherd.geometry import Array, BoolArray, ComplexArray, IntArray, wrap_angle
from skyherd.messages import ANONYMOUS_ID, BORDER_IDS, TIME_TOLERANCE_S, Proximity, find_rows
from skyherd.messages.checks import check_ids

SAME_PLACE_SIDES = 1.0
"""Distance up to which two reported positions may be of one body at rest, marker sides. Chosen: half of the
distance of two touching robots."""

SAME_PLACE_SHARE = 0.2
"""Additional distance as a share of the distance to the body. Chosen: a bearing error of 0.2 rad, from the
robot's own rotation between two images."""


class NeighborMemory:
    """Newest message about each pair of a robot and another body, as arrays over N robots and M bodies.

    The bodies include the four sides of an image, from the newest message that contains the robot.

    Bodies without identity have columns of their own, which are added when needed. Such a body is forgotten
    when a newer message reports a body at its place, or when it is stale. A newer message may also report an
    identified body at a place that it cannot have reached: another marker has its id. The memory then keeps
    the earlier place as a body without identity.

    A robot has no compass, but it knows its commanded turn rates. Directions are stored in the frame of the
    robot at the start of the run. They therefore remain valid while it turns. Robots that decide at equal
    time steps call `record_rotation` at each. Others pass `latency_compensation`, which has the times.

    Attributes:
        ids: (N,) the robots, ascending.
        other_ids: (M,) sides of the image, robots and obstacles, ascending; then `ANONYMOUS_ID` for each
            column of a body without identity.
        lifetime_s: age at which a message is stale.
        distances_sides: (N, M) distances between centres at the time of the image.
        reaches_sides: (N, M) distances between centres at which the two bodies touch.
        shares: (N, M) share of the gap that the robot may use up.
        ways_sides: (N, M) additional gap by which the robot makes way for another one.
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
        max_speed_sides_ps: maximum speed of a robot, marker sides per second; infinite if unknown, and every
            place is then within reach.
    """

    def __init__(
        self,
        ids: IntArray,
        other_ids: IntArray,
        lifetime_s: float,
        latency_compensation: LatencyCompensation | None = None,
        max_speed_sides_ps: float = np.inf,
    ) -> None:
        ids = check_ids(ids, "NeighborMemory.ids")
        other_ids = check_ids(other_ids, "NeighborMemory.other_ids")
        self.ids, self.lifetime_s = ids, lifetime_s
        self._latency_compensation, self._max_speed_sides_ps = latency_compensation, max_speed_sides_ps
        self._known_ids: IntArray = np.concatenate([BORDER_IDS, other_ids])
        self.other_ids: IntArray = self._known_ids
        shape = ids.size, self.other_ids.size
        self.distances_sides: Array = np.zeros(shape)
        self.reaches_sides: Array = np.zeros(shape)
        self.shares: Array = np.ones(shape)
        self.ways_sides: Array = np.zeros(shape)
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
        columns, is_body = find_rows(self._known_ids, np.concatenate([BORDER_IDS, message.ids]))
        rows, columns = rows[arrived & is_robot], columns[is_body]
        now = rows[self.seen_s[rows] <= message.time_s]
        self.seen_s[now], self.horizon_sides[now] = message.time_s, message.horizon_sides
        block = np.ix_(rows, columns)
        before = _Places.of(self, block) if np.isfinite(self._max_speed_sides_ps) else None
        before_s = self.imaged_s[block]
        self.imaged_s[block] = np.where(before_s <= message.time_s, -np.inf, before_s)
        hears = np.zeros(self.ids.size, dtype=bool)
        hears[rows] = True
        robot, is_robot = find_rows(self.ids, message.robot_ids)
        other, is_body = find_rows(self._known_ids, message.other_ids)
        mine = is_robot & hears[robot]
        directions_rad = np.zeros(robot.size)
        directions_rad[mine] = message.bearings_rad[mine] + self._rotation_at(
            message.time_s - (np.zeros(self.ids.size) if lead_s is None else lead_s)[robot[mine]], robot[mine]
        )
        newer = self.imaged_s[robot, other] <= message.time_s
        row = np.flatnonzero(mine & is_body & newer)
        reported = _Places.reported(message, directions_rad)
        reported.take(row).put_into(self, (robot[row], other[row]))
        bodies = np.flatnonzero(mine & (message.other_ids >= ANONYMOUS_ID))
        self._forget_anonymous(robot[bodies], reported.vectors[bodies], message.time_s)
        if before is not None:
            self._keep_contradicted(before, block, message)
        for pair in np.flatnonzero(mine & (message.other_ids == ANONYMOUS_ID)).tolist():
            place = robot[pair], self._free_column(int(robot[pair]), message.time_s)
            reported.take(pair).put_into(self, place)

    def _reach_sides(self, distances_sides: Array, age_s: Array) -> Array:
        """Return how far apart two reports of one body may be after `age_s`, marker sides.

        Both robots may have moved at full speed.
        """
        moved = 2 * self._max_speed_sides_ps * age_s if np.isfinite(self._max_speed_sides_ps) else 0.0
        return np.asarray(SAME_PLACE_SIDES + SAME_PLACE_SHARE * distances_sides + moved)

    def _forget_anonymous(self, robots: IntArray, vectors: ComplexArray, time_s: float) -> None:
        """Remove bodies without identity at whose places a message of `time_s` reports bodies.

        Args:
            robots: (P,) row of the robot of each reported body.
            vectors: (P,) positions of the reported bodies in the robots' frames at the start.
            time_s: time of the message's image.
        """
        first = self._known_ids.size
        if self.other_ids.size == first:
            return
        times_s = self.imaged_s[robots, first:]
        distances = self.distances_sides[robots, first:]
        known = distances * np.exp(1j * self.directions_rad[robots, first:])
        age_s = np.where(times_s > -np.inf, time_s - times_s, 0.0)
        same = np.abs(known - vectors[:, None]) <= self._reach_sides(distances, np.maximum(age_s, 0.0))
        of, column = np.nonzero(same & (age_s >= 0))
        self.imaged_s[robots[of], first + column] = -np.inf

    def _keep_contradicted(self, before: "_Places", block: tuple[IntArray, ...], message: Proximity) -> None:
        """Keep the earlier places of bodies that cannot have reached the places of this message.

        A body that the message omits is beyond the horizon.
        """
        age_s = message.time_s - before.imaged_s
        recent = (age_s >= 0) & (age_s <= self.lifetime_s) & (self._known_ids[block[1]] > BORDER_IDS[-1])
        if not recent.any():
            return
        after = _Places.of(self, block)
        beyond = message.horizon_sides + before.reaches_sides - before.distances_sides
        apart = np.where(after.imaged_s == message.time_s, np.abs(after.vectors - before.vectors), beyond)
        gone = recent & (apart > self._reach_sides(before.distances_sides, np.where(recent, age_s, 0.0)))
        for at in zip(*np.nonzero(gone), strict=True):
            row = int(block[0][at[0], 0])
            before.take(at).put_into(self, (row, self._free_column(row, message.time_s)))

    def _free_column(self, row: int, time_s: float) -> int:
        """Return a column for a body without identity near the robot of a row; add one if none is free."""
        first = self._known_ids.size
        free = np.flatnonzero(self.imaged_s[row, first:] < time_s - self.lifetime_s - TIME_TOLERANCE_S)
        if free.size:
            return first + int(free[0])
        more = ((0, 0), (0, 1))
        self.distances_sides = np.pad(self.distances_sides, more)
        self.reaches_sides = np.pad(self.reaches_sides, more)
        self.shares = np.pad(self.shares, more, constant_values=1.0)
        self.ways_sides = np.pad(self.ways_sides, more)
        self.directions_rad = np.pad(self.directions_rad, more)
        self.imaged_s = np.pad(self.imaged_s, more, constant_values=-np.inf)
        self.other_ids = np.append(self.other_ids, ANONYMOUS_ID)
        return int(self.other_ids.size) - 1

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

        A second call at one time replaces the first. With `latency_compensation` it does nothing.
        """
        if self._latency_compensation is not None:
            return
        if self._rotations and self._rotations[-1][0] == time_s:
            self._rotation_rad = self._rotations.pop()[1]
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


@dataclass(frozen=True)
class _Places:
    """Places of bodies, as arrays of one shape; the fields are as in `NeighborMemory`."""

    distances_sides: Array
    reaches_sides: Array
    shares: Array
    ways_sides: Array
    directions_rad: Array
    imaged_s: Array

    @classmethod
    def of(cls, memory: NeighborMemory, block: tuple[IntArray, ...]) -> "_Places":
        """Return a copy of the part of a memory in the rows and columns `block`."""
        return cls(*(getattr(memory, field.name)[block].copy() for field in fields(cls)))

    @classmethod
    def reported(cls, message: Proximity, directions_rad: Array) -> "_Places":
        """Return the places (P,) of a message's pairs, with directions (P,) in the frames at the start."""
        return cls(
            distances_sides=message.distances_sides,
            reaches_sides=message.reaches_sides,
            shares=message.shares,
            ways_sides=message.ways_sides,
            directions_rad=directions_rad,
            imaged_s=np.full(directions_rad.shape, message.time_s),
        )

    def take(self, at: Any) -> "_Places":
        """Return the places at indices."""
        return _Places(*(getattr(self, field.name)[at] for field in fields(self)))

    def put_into(self, memory: NeighborMemory, at: Any) -> None:
        """Store the places in a memory at the indices of robots and bodies."""
        for field in fields(self):
            getattr(memory, field.name)[at] = getattr(self, field.name)

    @property
    def vectors(self) -> ComplexArray:
        """Positions of the bodies in the robots' frames at the start, marker sides."""
        return np.asarray(self.distances_sides * np.exp(1j * self.directions_rad))
