"""A robot seen by several units puts their goals on one scale and adds them (paper, eq. 4-6).

The robots' receivers are kept as arrays over (unit, robot): each robot reads only its own column.
"""

import numpy as np

from skyherd.errors import MessageError
from skyherd.geometry import Array, BoolArray, ComplexArray, IntArray
from skyherd.messages import MotionGoals


class GoalInboxes:
    """The last goal that each robot heard from each unit, forgotten after `lifetime_s`.

    Goals may tell of neighbours that have no inbox; those distances are left out.

    Attributes:
        ids: (N,) the robots, ascending.
        unit_ids: (U,) the units that may send, ascending.
        rho_px: (U, N) goal vectors in each robot's frame, forward + i left, in the sender's pixels.
        sides_px: (U, N) the robot's own marker side in the sender's image.
        squares_px2: (U, N, N) squared image distances from robot to neighbour; 0 where not told, empty
            if nobody needs them.
        imaged_s: (U, N) time of the image that the goal stands for; -inf if none was heard.
        heard_s: (U, N) when it arrived.
    """

    def __init__(
        self, ids: IntArray, unit_ids: IntArray, lifetime_s: float, *, distances: bool = True
    ) -> None:
        if (np.diff(ids) <= 0).any() or (np.diff(unit_ids) <= 0).any():
            raise MessageError("GoalInboxes: ids and unit_ids must ascend, each once")
        units, robots = unit_ids.size, ids.size
        self.ids, self.unit_ids, self.lifetime_s = ids, unit_ids, lifetime_s
        self.rho_px: ComplexArray = np.zeros((units, robots), dtype=np.complex128)
        self.sides_px: Array = np.ones((units, robots))
        self.squares_px2: Array = np.zeros((units, robots, robots) if distances else (0, 0, 0))
        self.imaged_s: Array = np.full((units, robots), -np.inf)
        self.heard_s: Array = np.full((units, robots), -np.inf)

    def receive(self, goals: MotionGoals, time_s: float, received: BoolArray | None = None) -> None:
        """Take in one unit's goals that arrive now, unless newer ones did before.

        `received` (N,) tells which of its robots heard them, all if None.
        """
        unit = int(np.searchsorted(self.unit_ids[:-1], goals.unit_id))
        robots = np.searchsorted(self.ids[:-1], goals.ids)
        if goals.unit_id != self.unit_ids[unit] or (self.ids[robots] != goals.ids).any():
            raise MessageError(f"goals of unit {goals.unit_id} for robots that have no inbox here")
        heard = np.ones(len(goals), dtype=bool) if received is None else received
        robots = robots[heard]
        newer = goals.time_s >= self.imaged_s[unit, robots]
        robots, rows = robots[newer], np.flatnonzero(heard)[newer]
        self.rho_px[unit, robots] = goals.rho_px[rows] * np.exp(1j * goals.bearings_rad[rows])
        self.sides_px[unit, robots] = goals.sides_px[rows]
        self.imaged_s[unit, robots] = goals.time_s
        self.heard_s[unit, robots] = time_s
        if not self.squares_px2.size:
            return
        self.squares_px2[unit, robots] = 0.0
        row, column = np.nonzero(np.isin(goals.neighbor_ids[rows], self.ids))
        neighbors = np.searchsorted(self.ids, goals.neighbor_ids[rows][row, column])
        self.squares_px2[unit, robots[row], neighbors] = goals.neighbor_distances_px[rows][row, column] ** 2

    def fresh(self, time_s: float) -> BoolArray:
        """(U, N) goals young enough to follow."""
        return self.heard_s >= time_s - self.lifetime_s - 1e-9


def scale_ratios(inboxes: GoalInboxes) -> Array:
    """r_kj = r_k / r_j for each robot, (U, U, N) indexed [k, j, i].

    From the distances d_k ≈ r_kj d_j to all neighbours that both messages name: the geometric mean of the two
    least-squares slopes, of d_k on d_j and of the inverse one of d_j on d_k,

        r_kj = sqrt(Σ_n d_kn² / Σ_n d_jn²),

    which takes both as noisy and keeps r_kj r_jk = 1. Without a common neighbour the ratio of the robot's own
    marker sides stands in, which rests on few pixels.
    """
    squares = inboxes.squares_px2
    told = (squares > 0).astype(float)
    common = np.einsum("kin,jin->kji", squares, told)
    total = common.transpose(1, 0, 2)
    sides = inboxes.sides_px
    fallback = sides[:, None, :] / sides[None, :, :]
    squared = np.divide(common, total, out=fallback**2, where=(common > 0) & (total > 0))
    return np.asarray(np.sqrt(squared))


def fuse_pixels(inboxes: GoalInboxes, time_s: float) -> ComplexArray:
    """rho_i^g (N,), px: `1/|C_i| Σ_j Σ_k r_kj rho_i^j` over the units heard (eq. 4); 0 where none is."""
    fresh = inboxes.fresh(time_s)
    pairs = fresh[:, None, :] & fresh[None, :, :]
    weights = np.where(pairs, scale_ratios(inboxes), 0.0).sum(axis=0)
    count = np.maximum(fresh.sum(axis=0), 1)
    return np.asarray((weights * np.where(fresh, inboxes.rho_px, 0)).sum(axis=0) / count)


def fuse_marker_sides(inboxes: GoalInboxes, time_s: float) -> ComplexArray:
    """Σ_j rho_i^j / side_px_ij (N,), marker sides: the common scale; 0 if none is heard."""
    heard = _unit, robot = np.nonzero(inboxes.fresh(time_s))
    rho, robots = inboxes.rho_px[heard] / inboxes.sides_px[heard], inboxes.ids.size
    along, across = (np.bincount(robot, weights=part, minlength=robots) for part in (rho.real, rho.imag))
    return along + 1j * across
