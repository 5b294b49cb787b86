"""Places assigned at the start: the nearest copy of the shape over all permutations."""

from itertools import permutations

import numpy as np
import pytest

from skyherd.control import Template
from skyherd.datasets import load_mission
from skyherd.datasets.configuration.start import with_assigned_roles
from skyherd.errors import InputError
from skyherd.geometry import to_points


def residual(robots: np.ndarray, points: np.ndarray, *, turns: bool) -> float:
    """Return the squared distance of robots from the nearest copy of the points, of any size."""
    x, p = robots - robots.mean(), points - points.mean()
    z = np.vdot(p, x)
    z = abs(z) if turns else max(z.real, 0.0)
    return float(np.vdot(x, x).real - z**2 / np.vdot(p, p).real)


@pytest.mark.parametrize("assigned", ["similar", "parallel"])
@pytest.mark.parametrize("seed", range(6))
def test_assignment_is_best_of_all_permutations(assigned, seed) -> None:
    """Six robots have 720 assignments; the search over rotations has 24 starts."""
    rng = np.random.default_rng(seed)
    robots, shape = (rng.standard_normal(6) + 1j * rng.standard_normal(6) for _ in range(2))
    ids = np.array([3, 5, 6, 8, 9, 12])
    template = Template.from_ground_points(ids, to_points(shape))
    found = with_assigned_roles(template, ids, to_points(robots), assigned).points_of(ids).conj()
    turns = assigned == "similar"
    best = min(residual(robots, shape[list(order)], turns=turns) for order in permutations(range(6)))
    assert residual(robots, found, turns=turns) == pytest.approx(best, abs=1e-9)
    assert sorted(np.round(found, 9).tolist(), key=abs) == sorted(np.round(shape, 9).tolist(), key=abs)


def test_assigned_places_shorten_paths_of_crowd() -> None:
    """A robot of the crowd has a random place otherwise."""
    errors = []
    for assigned in ("none", "similar"):
        mission = load_mission("crowd", [f"roles.assigned={assigned}"])
        robots = mission.positions_m @ np.array([1, 1j])
        errors.append(residual(robots, mission.template.points_of(mission.ids).conj(), turns=True))
    assert errors[1] < 0.3 * errors[0]


def test_assignment_for_several_shapes_is_rejected() -> None:
    with pytest.raises(InputError, match=r"roles\.assigned"):
        load_mission("letters", ["roles.assigned=similar"])
