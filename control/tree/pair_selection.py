"""Choice of the two robots that two neighbours share: the nearest, or those with the fastest agreement.

Two units that share a pair of robots agree on the shape at a rate with a closed form
(`skyherd.control.topology.convergence_rate.pair_rates`). The rate depends only on the control sets of the two
units and the template, not on the robots' present positions. A unit can therefore compare pairs that it does
not see. The rule `leverage` shares the pair with the highest rate. The paper's rule, `nearest`, shares the
two robots nearest to the image centre. Under both rules, pairs that hand over robots which one unit prefers
to release to the other have priority.
"""

from collections.abc import Mapping
from itertools import combinations

import numpy as np

from skyherd.control.formation.template import Template
from skyherd.control.topology.convergence_rate import pair_rates
from skyherd.control.tree.edge import NO_ROBOTS, Robots
from skyherd.control.tree.node_state import PairRule
from skyherd.geometry import Array, IntArray
from skyherd.messages import among

MIN_DISTANCE = 1e-9
"""Minimum sum of distances, half images. Chosen: it avoids a division by zero for two robots at the image
centre."""


def choose_pair(
    share: PairRule,
    template: Template,
    *,
    candidates: Robots,
    distances: Mapping[int, float],
    present: Robots,
    theirs: IntArray,
    ours: IntArray,
    to_take: Robots,
    to_leave: Robots,
    gain: float,
) -> Robots | None:
    """Return the pair to change to, or None if the present one is good enough.

    The chosen pair moves the most robots to the unit that should have them. Among those, `leverage` takes the
    pair with the fastest agreement of the two units' fits (`pair_rates`). `nearest` takes the two robots
    nearest to the unit's image centre (the paper's rule). A pair that moves no robot must be better than the
    present one by the factor `gain`, so that noise has no effect.

    Args:
        share: the rule.
        template: the whole shape.
        candidates: robots that both units see and that may be shared.
        distances: distances of the candidates from the unit's image centre.
        present: the pair shared now; if empty, or with a member that is no candidate, it must be changed.
        theirs: the neighbour's set, ascending.
        ours: the unit's set without the present pair, ascending.
        to_take: robots that the neighbour prefers to release.
        to_leave: robots of the present pair that the unit prefers to release.
        gain: factor by which a new pair must be better.
    """
    robots = sorted(candidates)
    if len(robots) < 2:
        return None
    pairs = np.array(list(combinations(robots, 2)), dtype=np.int64)
    merit = _leverage(template, pairs, theirs, ours) if share == "leverage" else _nearness(pairs, distances)
    moved = _count_in(pairs, to_take)
    moved += len(to_leave) - _count_in(pairs, to_leave)
    best = int(np.lexsort((-merit, -moved))[0])
    if not merit[best] > 0:
        return None
    chosen = frozenset(pairs[best].tolist())
    if present <= candidates and len(present) == 2:
        now = int(np.flatnonzero((pairs == sorted(present)).all(axis=1))[0])
        if moved[best] <= moved[now] and merit[best] < gain * merit[now]:
            return None
    return None if chosen == present else chosen


def stronger_pair(
    template: Template,
    present: Robots,
    candidates: Robots,
    theirs: Robots,
    ours: Robots,
    firm: float,
    gain: float,
) -> Robots:
    """Return the pair to bring into view if the present one couples two units weakly; none if it is strong.

    Candidates must reach the rate `firm`, or the highest possible rate, and exceed the present rate by the
    factor `gain`. Of these pairs, the one nearest to the unit's own robots in the shape is chosen.
    """
    robots = sorted(candidates | present)
    pairs = np.array(list(combinations(robots, 2)), dtype=np.int64)
    rates = _leverage(template, pairs, np.array(sorted(theirs)), np.array(sorted(ours), dtype=np.int64))
    now = rates[(pairs == sorted(present)).all(axis=1)][0]
    enough = np.flatnonzero((rates >= min(firm, float(rates.max()))) & (rates >= gain * now) & (rates > 0))
    if now >= firm or not ours or not enough.size:
        return NO_ROBOTS
    points, rows = template.points_px, np.searchsorted(template.ids, pairs[enough])
    middle = points[np.searchsorted(template.ids, sorted(ours | present))].mean()
    nearest = int(np.argmin(np.abs(points[rows] - middle).max(axis=1)))
    return frozenset(pairs[enough[nearest]].tolist())


def _leverage(template: Template, pairs: IntArray, theirs: IntArray, ours: IntArray) -> Array:
    """Return the rates (P,) at which the fits of two units with these sets agree, for each candidate pair."""
    rows = np.searchsorted(template.ids, pairs)
    fixed, moving = (np.searchsorted(template.ids, ids) for ids in (theirs, ours))
    return pair_rates(template.points_px, fixed, moving, rows)


def _nearness(pairs: IntArray, distances: Mapping[int, float]) -> Array:
    """Return the inverse (P,) of each pair's summed distance from the image centre, in half images."""
    total = [distances[a] + distances[b] for a, b in pairs.tolist()]
    return 1 / np.maximum(total, MIN_DISTANCE)


def _count_in(pairs: IntArray, robots: Robots) -> IntArray:
    """Return the number (P,) of the robots that each of the pairs (P, 2) contains."""
    return np.asarray(among(pairs, robots).sum(axis=1))
