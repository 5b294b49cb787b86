"""Robots' memory: what each has heard of bodies near it, and when, and how it has turned since."""

from collections import deque

import numpy as np

from skyherd.geometry import Array, BoolArray, IntArray, wrap_angle
from skyherd.messages import Proximity


class NeighborMemory:
    """The newest word on each pair of robot and other body, as arrays over (robot, other).

    A robot has no compass, but knows how it was told to turn: directions are kept in the frame that it had
    at the start, so that they stay right while it turns.

    Attributes:
        ids: (N,) the robots, ascending.
        other_ids: (M,) robots and obstacles, ascending.
        distances_sides: (N, M) between centres, at the image's time.
        reaches_sides: (N, M) distance at which the two touch.
        shares: (N, M) part of the gap that is the robot's.
        directions_rad: (N, M) in the frame of each robot at the start.
        imaged_s: (N, M) time of the image; -inf where nothing is known, or they are far apart.
        horizon_sides: (N,) what the robot was not told of was farther away than this,
        seen_s: (N,) when it was last seen by a unit that it heard; -inf if never.
    """

    def __init__(self, ids: IntArray, other_ids: IntArray, lifetime_s: float) -> None:
        shape = ids.size, other_ids.size
        self.ids, self.other_ids, self.lifetime_s = ids, other_ids, lifetime_s
        self.distances_sides: Array = np.zeros(shape)
        self.reaches_sides: Array = np.zeros(shape)
        self.shares: Array = np.ones(shape)
        self.directions_rad: Array = np.zeros(shape)
        self.imaged_s: Array = np.full(shape, -np.inf)
        self.horizon_sides: Array = np.zeros(ids.size)
        self.seen_s: Array = np.full(ids.size, -np.inf)
        self._turned_rad: Array = np.zeros(ids.size)
        self._turns: deque[tuple[float, Array]] = deque()

    def receive(self, message: Proximity, received: BoolArray | None = None) -> None:
        """Take in what a unit tells; `received` (N,) says which of those addressed heard it, all if None."""
        heard = np.ones(len(message), dtype=bool) if received is None else received
        rows = np.searchsorted(self.ids, np.intersect1d(message.ids[heard], self.ids))
        now = rows[self.seen_s[rows] <= message.time_s]
        self.seen_s[now], self.horizon_sides[now] = message.time_s, message.horizon_sides
        columns = np.searchsorted(self.other_ids, np.intersect1d(message.ids, self.other_ids))
        block = np.ix_(rows, columns)
        self.imaged_s[block] = np.where(self.imaged_s[block] <= message.time_s, -np.inf, self.imaged_s[block])
        told = np.isin(message.robot_ids, self.ids[rows]) & np.isin(message.other_ids, self.other_ids)
        robot = np.searchsorted(self.ids, message.robot_ids[told])
        other = np.searchsorted(self.other_ids, message.other_ids[told])
        newer = self.imaged_s[robot, other] <= message.time_s
        pair, word = (robot[newer], other[newer]), np.flatnonzero(told)[newer]
        self.distances_sides[pair] = message.distances_sides[word]
        self.reaches_sides[pair] = message.reaches_sides[word]
        self.shares[pair] = message.shares[word]
        self.directions_rad[pair] = message.bearings_rad[word] + self._turned_at(message.time_s)[pair[0]]
        self.imaged_s[pair] = message.time_s

    def fresh(self, time_s: float) -> tuple[IntArray, IntArray]:
        """Rows and columns of the pairs that count now."""
        row, column = np.nonzero(self.imaged_s >= time_s - self.lifetime_s - 1e-9)
        return row.astype(np.int64), column.astype(np.int64)

    def bearings_rad(self, pair: tuple[IntArray, IntArray]) -> Array:
        """Directions (P,) of the others in the robots' frames now."""
        return wrap_angle(self.directions_rad[pair] - self._turned_rad[pair[0]])

    def turn(self, omega_radps: Array, time_s: float, step_s: float) -> None:
        """Note the turn rates (N,) that are commanded from now on for `step_s`."""
        self._turns.append((time_s, self._turned_rad))
        while self._turns[0][0] < time_s - self.lifetime_s:
            self._turns.popleft()
        self._turned_rad = self._turned_rad + omega_radps * step_s

    def _turned_at(self, time_s: float) -> Array:
        """How far each robot had turned by then (N,)."""
        times = [at for at, _ in self._turns]
        row = int(np.searchsorted(times, time_s - 1e-9))
        return self._turns[row][1] if row < len(times) else self._turned_rad
