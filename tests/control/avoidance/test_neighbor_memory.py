"""The robots' memory of the messages on nearby bodies."""

import numpy as np

from skyherd.control import NeighborMemory
from skyherd.messages import Proximity

ROBOTS = np.array([2, 3, 7, 11])
BODIES = np.array([2, 3, 5, 7, 11])
"""The robots, and an obstacle."""


def test_neighbor_memory_keeps_newest_message_of_each_pair() -> None:
    """The reference is a dictionary of pairs filled message by message, with unknown ids among them."""
    rng = np.random.default_rng(17)
    memory = NeighborMemory(ROBOTS, BODIES, lifetime_s=100.0)
    known: dict[tuple[int, int], tuple[float, float]] = {}
    for time_s in rng.integers(0, 10, 60).tolist():  # some of two units at one time
        ids = rng.permutation(np.append(BODIES, [0, 6, 40]))[: rng.integers(1, 8)]
        received = rng.random(ids.size) < 0.6
        robot, other = (
            index[rng.random(index.size) < 0.5] for index in np.nonzero(~np.eye(ids.size, dtype=bool))
        )
        pairs = min(robot.size, other.size)
        robot, other = ids[robot[:pairs]], ids[other[:pairs]]
        distances = rng.uniform(1, 9, pairs)
        memory.receive(
            Proximity(0, time_s, 8.0, ids, robot, other, distances, *np.zeros((3, pairs))), received
        )
        hearers = set(ids[received].tolist()) & set(ROBOTS.tolist())
        for pair in [(a, b) for a in hearers for b in ids.tolist()]:
            if pair in known and known[pair][0] <= time_s:
                del known[pair]
        before = dict(known)
        for a, b, distance in zip(robot.tolist(), other.tolist(), distances.tolist(), strict=True):
            if a in hearers and b in BODIES and before.get((a, b), (-np.inf, 0.0))[0] <= time_s:
                known[a, b] = time_s, distance
        rows, columns = memory.fresh(time_s)
        pair_ids = zip(ROBOTS[rows].tolist(), memory.other_ids[columns].tolist(), strict=True)
        values = zip(
            memory.imaged_s[rows, columns].tolist(),
            memory.distances_sides[rows, columns].tolist(),
            strict=True,
        )
        assert dict(zip(pair_ids, values, strict=True)) == known
    assert len(known) > 5
