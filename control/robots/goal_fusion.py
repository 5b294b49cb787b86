"""Fusion of the goals of several units on a common scale (paper, eq. 4-6).

Each unit sends its goal vector in its own pixels. A robot that several units control uses one of two common
scales. The paper's uses the image distances in the messages. The other divides each vector by the side of the
robot's own marker in that unit's image, and needs no distances.

The inboxes of all robots are arrays over (unit, robot), for speed alone: each robot reads only its own
column.
"""

import numpy as np

from skyherd.errors import MessageError
from skyherd.geometry import Array, BoolArray, ComplexArray, IntArray
from skyherd.messages import TIME_TOLERANCE_S, MotionGoals, find_rows, rows_of
from skyherd.messages.checks import check_ids, check_numbers, shown


class GoalInboxes:
    """Newest goal of each of N robots from each of U units; a goal is stale after `lifetime_s`.

    The lifetime is a watchdog: a robot without a fresh goal stops. Message loss therefore never keeps a robot
    moving for longer. Goals may contain neighbours without an inbox here; their distances are ignored.

    Attributes:
        ids: (N,) the robots, ascending.
        unit_ids: (U,) the units that may send, ascending.
        lifetime_s: age, since reception, at which a goal is stale.
        rho_px: (U, N) goal vectors in each robot's frame, `forward + i left`, in the sender's pixels.
        sides_px: (U, N) side of the robot's own marker in the sender's image.
        squares_px2: (U, N, N) squared image distances from robot to neighbour, 0 where none was sent; empty
            if `distances` is false.
        imaged_s: (U, N) time of the image of the goal; -inf if none was received.
        received_s: (U, N) time of reception; -inf if none was received.

    Args:
        ids: (N,) the robots, ascending.
        unit_ids: (U,) the units, ascending.
        lifetime_s: as the attribute.
        distances: whether to store image distances, which only `scale_ratios` needs.

    Raises:
        MessageError: `ids` or `unit_ids` do not ascend.
        InputError: they are not integers from 0 up, or `lifetime_s` is not positive.
    """

    def __init__(
        self, ids: IntArray, unit_ids: IntArray, lifetime_s: float, *, distances: bool = True
    ) -> None:
        ids, unit_ids = check_ids(ids, "GoalInboxes.ids"), check_ids(unit_ids, "GoalInboxes.unit_ids")
        if (np.diff(ids) <= 0).any() or (np.diff(unit_ids) <= 0).any():
            given = f"ids {shown(ids)}, unit_ids {shown(unit_ids)}"
            raise MessageError("GoalInboxes", given, "ascending, each once")
        units, robots = unit_ids.size, ids.size
        self.ids, self.unit_ids, self.lifetime_s = ids, unit_ids, lifetime_s
        check_numbers(self, positive=("lifetime_s",))
        self.rho_px: ComplexArray = np.zeros((units, robots), dtype=np.complex128)
        self.sides_px: Array = np.ones((units, robots))
        self.squares_px2: Array = np.zeros((units, robots, robots) if distances else (0, 0, 0))
        self.imaged_s: Array = np.full((units, robots), -np.inf)
        self.received_s: Array = np.full((units, robots), -np.inf)

    def receive(self, goals: MotionGoals, time_s: float, received: BoolArray | None = None) -> None:
        """Store the goals of one unit that arrive at `time_s`; goals of an older image are ignored.

        Args:
            goals: goals for N robots.
            time_s: present time.
            received: (N,) mask of the addressed robots that received the message; all if None.

        Raises:
            MessageError: the unit or an addressed robot has no inbox here, or `received` is no such mask.
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
        """Return the mask (U, N) of the goals that are not stale at `time_s`."""
        return self.received_s >= time_s - self.lifetime_s - TIME_TOLERANCE_S


def _check_mask(received: object, count: int) -> None:
    """Raise MessageError unless `received` is a mask of `count` booleans."""
    if not isinstance(received, np.ndarray) or received.dtype != np.bool_:
        raise MessageError("GoalInboxes.receive: received", shown(received), "an array of booleans")
    if received.shape != (count,):
        raise MessageError(
            "GoalInboxes.receive: received", f"shape {received.shape}", f"shape {(count,)}, one a goal"
        )


def scale_ratios(inboxes: GoalInboxes) -> Array:
    """Return the ratios r_kj = r_k / r_j of the units' image scales, (U, U, N) indexed [k, j, i].

    The paper (Section IV) divides the two image distances to one neighbour. Here all neighbours in both
    messages are used. The ratio is the geometric mean of two least-squares slopes: of d_k on d_j, and of the
    inverse of d_j on d_k,

        r_kj = sqrt(Σ_n d_kn² / Σ_n d_jn²).

    This treats both as noisy and keeps r_kj r_jk = 1. Without a common neighbour the ratio of the sides of
    the robot's own marker is used, which is less accurate. The inboxes must store distances.
    """
    squares = inboxes.squares_px2
    known = (squares > 0).astype(float)
    common = np.einsum("kin,jin->kji", squares, known)
    total = common.transpose(1, 0, 2)
    sides = inboxes.sides_px
    fallback = sides[:, None, :] / sides[None, :, :]
    squared = np.divide(common, total, out=fallback**2, where=common > 0)  # total > 0 as well then
    return np.asarray(np.sqrt(squared))


def fuse_pixels(inboxes: GoalInboxes, time_s: float) -> ComplexArray:
    """Return the paper's global motion vectors ρ_i^g (N,), px, in the robots' frames (eq. 4).

        ρ_i^g = 1 / |C_i| Σ_j Σ_k r_kj ρ_i^j,

    over the units C_i with fresh goals; 0 without any. It equals the mean scale of these units times the sum
    of the ground vectors (eq. 5-6). Its length therefore depends on the cameras.
    """
    fresh = inboxes.fresh(time_s)
    pairs = fresh[:, None, :] & fresh[None, :, :]
    weights = np.where(pairs, scale_ratios(inboxes), 0.0).sum(axis=0)
    count = np.maximum(fresh.sum(axis=0), 1)
    return np.asarray((weights * np.where(fresh, inboxes.rho_px, 0)).sum(axis=0) / count)


def fuse_marker_sides(inboxes: GoalInboxes, time_s: float) -> ComplexArray:
    """Return goal vectors Σ_j ρ_i^j / side_ij (N,), marker sides, in robot frames; 0 if all goals are stale.

    side_ij is the side of robot i's marker in the image of unit j, px. All units see the same side on the
    ground. The sum therefore does not depend on cameras, zooms and heights.
    """
    fresh = _unit, robot = np.nonzero(inboxes.fresh(time_s))
    rho, robots = inboxes.rho_px[fresh] / inboxes.sides_px[fresh], inboxes.ids.size
    along, across = (np.bincount(robot, weights=part, minlength=robots) for part in (rho.real, rho.imag))
    return along + 1j * across
