"""Goals from several units brought to one scale and added (paper, eq. 4-6).

Each unit sends its goal vector in its own pixels. A robot that several units control either brings them to
a common scale by the image distances that the units send along, as in the paper, or divides each by the side
of its own marker in that unit's image, which needs no distances.

The inboxes of all robots are arrays over (unit, robot), for speed alone: each robot reads only its own
column.
"""

import numpy as np

from skyherd.errors import MessageError
from skyherd.geometry import Array, BoolArray, ComplexArray, IntArray
from skyherd.messages import TIME_TOLERANCE_S, MotionGoals, find_rows, rows_of
from skyherd.messages.checks import check_ids, check_numbers, shown


class GoalInboxes:
    """The newest goal that each of N robots received from each of U units, dropped after `lifetime_s`.

    Goals may name neighbours that have no inbox here; the distances to those are left out.

    Attributes:
        ids: (N,) the robots, ascending.
        unit_ids: (U,) the units that may send, ascending.
        lifetime_s: age, since it was received, at which a goal is no longer followed.
        rho_px: (U, N) goal vectors in each robot's frame, `forward + i left`, in the sender's pixels.
        sides_px: (U, N) side of the robot's own marker in the sender's image.
        squares_px2: (U, N, N) squared image distances from robot to neighbour, 0 where none was sent; empty
            if `distances` is false.
        imaged_s: (U, N) time of the image that the goal was computed from; -inf if none was received.
        received_s: (U, N) time at which it was received; -inf if none was.

    Args:
        ids: (N,) the robots, ascending.
        unit_ids: (U,) the units, ascending.
        lifetime_s: as the attribute.
        distances: whether to keep image distances, which only `scale_ratios` needs.

    Raises:
        MessageError: `ids` or `unit_ids` do not ascend.
        InputError: they are no whole numbers from 0 up, or `lifetime_s` is not above 0.
    """

    def __init__(
        self, ids: IntArray, unit_ids: IntArray, lifetime_s: float, *, distances: bool = True
    ) -> None:
        ids, unit_ids = check_ids(ids, "GoalInboxes.ids"), check_ids(unit_ids, "GoalInboxes.unit_ids")
        if (np.diff(ids) <= 0).any() or (np.diff(unit_ids) <= 0).any():
            raise MessageError("GoalInboxes: ids and unit_ids must ascend, each once")
        units, robots = unit_ids.size, ids.size
        self.ids, self.unit_ids, self.lifetime_s = ids, unit_ids, lifetime_s
        check_numbers(self, positive=("lifetime_s",))
        self.rho_px: ComplexArray = np.zeros((units, robots), dtype=np.complex128)
        self.sides_px: Array = np.ones((units, robots))
        self.squares_px2: Array = np.zeros((units, robots, robots) if distances else (0, 0, 0))
        self.imaged_s: Array = np.full((units, robots), -np.inf)
        self.received_s: Array = np.full((units, robots), -np.inf)

    def receive(self, goals: MotionGoals, time_s: float, received: BoolArray | None = None) -> None:
        """Take in the goals of one unit that arrive at `time_s`; goals of an older image change nothing.

        Args:
            goals: goals for N robots.
            time_s: now.
            received: (N,) mask of the robots addressed that received the message; all if None.

        Raises:
            MessageError: the unit or a robot addressed has no inbox here, or `received` is no such mask.
        """
        if received is not None:
            _check_mask(received, len(goals))
        unit, robots = int(rows_of(self.unit_ids, goals.unit_id)), rows_of(self.ids, goals.ids)
        arrived = np.ones(len(goals), dtype=bool) if received is None else received
        robots = robots[arrived]
        newer = goals.time_s >= self.imaged_s[unit, robots]
        robots, rows = robots[newer], np.flatnonzero(arrived)[newer]
        self.rho_px[unit, robots] = goals.rho_px[rows] * np.exp(1j * goals.bearings_rad[rows])
        self.sides_px[unit, robots] = goals.sides_px[rows]
        self.imaged_s[unit, robots] = goals.time_s
        self.received_s[unit, robots] = time_s
        if not self.squares_px2.size:
            return
        self.squares_px2[unit, robots] = 0.0
        neighbors, known = find_rows(self.ids, goals.neighbor_ids[rows])
        row, column = np.nonzero(known)
        distances_px = goals.neighbor_distances_px[rows][row, column]
        self.squares_px2[unit, robots[row], neighbors[row, column]] = distances_px**2

    def fresh(self, time_s: float) -> BoolArray:
        """(U, N) mask of the goals that are young enough to be followed at `time_s`."""
        return self.received_s >= time_s - self.lifetime_s - TIME_TOLERANCE_S


def _check_mask(received: BoolArray, count: int) -> None:
    if not isinstance(received, np.ndarray) or received.dtype != np.bool_:
        raise MessageError(
            f"GoalInboxes.receive: received is {shown(received)}, expected an array of booleans"
        )
    if received.shape != (count,):
        raise MessageError(
            f"GoalInboxes.receive: received has shape {received.shape}, expected {(count,)}, one a goal"
        )


def scale_ratios(inboxes: GoalInboxes) -> Array:
    """Ratios r_kj = r_k / r_j of the units' image scales (paper, Section IV), (U, U, N) indexed [k, j, i].

    The paper divides the two image distances to one neighbour. Here all neighbours that both messages name
    are used: the ratio is the geometric mean of the two least-squares slopes, of the distances d_k on d_j and
    of the inverse of d_j on d_k,

        r_kj = sqrt(Σ_n d_kn² / Σ_n d_jn²),

    which treats both as noisy and keeps r_kj r_jk = 1. Without a common neighbour the ratio of the sides of
    the robot's own marker takes its place, which rests on fewer pixels. The inboxes must keep distances.
    """
    squares = inboxes.squares_px2
    known = (squares > 0).astype(float)
    common = np.einsum("kin,jin->kji", squares, known)
    total = common.transpose(1, 0, 2)
    sides = inboxes.sides_px
    fallback = sides[:, None, :] / sides[None, :, :]
    squared = np.divide(common, total, out=fallback**2, where=common > 0)  # then the other sum is as well
    return np.asarray(np.sqrt(squared))


def fuse_pixels(inboxes: GoalInboxes, time_s: float) -> ComplexArray:
    """The paper's global motion vectors ρ_i^g (N,), px, in the robots' frames (eq. 4).

        ρ_i^g = 1 / |C_i| Σ_j Σ_k r_kj ρ_i^j,

    over the units C_i whose goals are fresh; 0 where none is. Equal to the mean scale of these units times
    the sum of the ground vectors (eq. 5-6), so that its length depends on the cameras.
    """
    fresh = inboxes.fresh(time_s)
    pairs = fresh[:, None, :] & fresh[None, :, :]
    weights = np.where(pairs, scale_ratios(inboxes), 0.0).sum(axis=0)
    count = np.maximum(fresh.sum(axis=0), 1)
    return np.asarray((weights * np.where(fresh, inboxes.rho_px, 0)).sum(axis=0) / count)


def fuse_marker_sides(inboxes: GoalInboxes, time_s: float) -> ComplexArray:
    """Goal vectors Σ_j ρ_i^j / side_ij (N,), marker sides, in the robots' frames; 0 without a fresh goal.

    side_ij is the side of robot i's marker in the image of unit j, px. The side on the ground is a length
    that all units see, so that the sum does not depend on cameras, zooms and heights.
    """
    fresh = _unit, robot = np.nonzero(inboxes.fresh(time_s))
    rho, robots = inboxes.rho_px[fresh] / inboxes.sides_px[fresh], inboxes.ids.size
    along, across = (np.bincount(robot, weights=part, minlength=robots) for part in (rho.real, rho.imag))
    return along + 1j * across
