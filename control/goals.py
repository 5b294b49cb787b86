"""Motion goals of a unit for its robots, in each robot's own frame, and image distances (eq. 2-3)."""

from dataclasses import replace

import numpy as np

from skyherd.control.formation.similarity import fit_goals
from skyherd.control.formation.template import Template
from skyherd.geometry import Array, BoolArray, ComplexArray, IntArray, to_complex
from skyherd.messages import Detections, MotionGoals, among, rows_of
from skyherd.messages.checks import check_kind


def motion_goals(
    seen: Detections,
    controlled_ids: IntArray,
    template: Template,
    *,
    shared_ids: IntArray,
    nearest: int,
    scales: tuple[float, float] = (0.0, np.inf),
) -> MotionGoals:
    """Compute the goals of one unit for the robots it controls and sees.

    The goal vector is `rho_i^j = p_i^{d,j} - p_i^j` (eq. 2). Its direction in the robot's frame is the angle
    from the heading y to rho: `bearing = -(arg rho - heading)`. The paper's angle (eq. 3) is `pi - bearing`,
    with its z axis up, that is, for image coordinates (u, -v).

    Args:
        seen: all robots of the team in the image.
        controlled_ids: S_j^c; its members that are not in `seen` get no goal.
        template: the whole shape.
        shared_ids: robots that other units control as well; their distances are always sent.
        nearest: number of nearest robots in the image whose distances are sent as well.
        scales: bounds of the similarity's scale, image pixels per template pixel (control/formation/size.py).

    Raises:
        DegenerateSetError: fewer than two controlled robots are visible, or all coincide.
    """
    check_kind("motion_goals: seen", seen, Detections, "Detections")
    check_kind("motion_goals: template", template, Template, "a Template")
    rows = np.flatnonzero(among(seen.ids, controlled_ids))
    ids, seen_px = seen.ids[rows], to_complex(seen.centers_px)
    points, current = template.points_of(ids), seen_px[rows]
    rho = fit_goals(points, current).resized(*scales)(points) - current
    distances = np.abs(current[:, None] - seen_px)
    is_sent = (_nearest_mask(distances, nearest) | among(seen.ids, shared_ids)) & (ids[:, None] != seen.ids)
    neighbor_ids, neighbor_distances = _as_rows(is_sent, seen.ids, distances)
    return MotionGoals(
        unit_id=seen.unit_id,
        time_s=seen.time_s,
        ids=ids,
        rho_px=np.abs(rho),
        bearings_rad=np.angle(_in_robot_frames(rho, seen.headings_rad[rows])),
        sides_px=seen.sides_px[rows],
        neighbor_ids=neighbor_ids,
        neighbor_distances_px=neighbor_distances,
    )


def _in_robot_frames(vectors_px: ComplexArray, headings_rad: Array) -> ComplexArray:
    """Return image vectors (N,) in the frames of robots with headings (N,), `forward + i left`.

    Image angles run clockwise seen from above, the robot's counter-clockwise: the only flip of sense.
    """
    return np.asarray((vectors_px * np.exp(-1j * headings_rad)).conj())


def led_goals(goals: MotionGoals, seen: Detections, leads_px: ComplexArray) -> MotionGoals:
    """Return goals with leads (N,), image vectors in px, added to them (control/formation/motion.py)."""
    headings_rad = seen.headings_rad[rows_of(seen.ids, goals.ids)]
    rho = goals.rho_px * np.exp(1j * goals.bearings_rad) + _in_robot_frames(leads_px, headings_rad)
    return replace(goals, rho_px=np.abs(rho), bearings_rad=np.angle(rho))


def lyapunov_term(goals: MotionGoals | None) -> float:
    """Return the term V^j of one unit in the Lyapunov function V (paper, eq. 9), in marker sides squared.

    `V^j = 1/2 Σ_i (rho_i / side_i)²` over the robots i with a goal, each in sides of its own marker. It is 0
    without goals. The sum V = Σ_j V^j is the Lyapunov function of Theorem 1: it never increases under a fixed
    topology.
    """
    return 0.0 if goals is None else float(((goals.rho_px / goals.sides_px) ** 2).sum() / 2)


def _as_rows(is_sent: BoolArray, ids: IntArray, distances: Array) -> tuple[IntArray, Array]:
    """Return padded rows of the neighbours to send: ids (N, K), filled with -1, and distances, filled with 0.

    `is_sent` (N, M) selects them for each robot, among the M robots `ids` at `distances` (N, M).
    """
    counts = is_sent.sum(axis=1)
    width = int(counts.max(initial=0))
    neighbor_ids = np.full((len(is_sent), width), -1, dtype=np.int64)
    neighbor_distances = np.zeros((len(is_sent), width))
    filled = np.arange(width) < counts[:, None]
    neighbor_ids[filled] = ids[np.nonzero(is_sent)[1]]
    neighbor_distances[filled] = distances[is_sent]
    return neighbor_ids, neighbor_distances


def _nearest_mask(distances: Array, nearest: int) -> BoolArray:
    """Return a mask (N, M) of the `nearest + 1` smallest of each row: the robot itself and its neighbours."""
    count = min(nearest + 1, distances.shape[1])
    order = np.argpartition(distances, count - 1, axis=1)[:, :count]
    mask = np.zeros(distances.shape, dtype=bool)
    mask[np.arange(len(order))[:, None], order] = True
    return mask
