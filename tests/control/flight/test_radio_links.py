"""Units in flight keep the radio links that connect them."""

from importlib import import_module

import numpy as np
import pytest
from scipy.sparse.csgraph import breadth_first_order, minimum_spanning_tree
from scipy.spatial.distance import pdist, squareform

from skyherd.control import FlightTask, KeepInView, Template
from skyherd.control.flight.radio_links import HOLD_SHARE, TIE_SHARE, kept_links, within_links
from skyherd.datasets import Crowd, make_mission, random_mission
from skyherd.geometry import to_complex, to_points
from skyherd.loop import run_steps

CENTRE, HALF_PX = 399.5 + 399.5j, 400.0
TEMPLATE = Template(np.arange(8), np.exp(2j * np.pi * np.arange(8) / 8))


def links_of(places: np.ndarray) -> set[tuple[int, int]]:
    """Return the kept links (unit, other) of all units at places (U,)."""
    links = set()
    for unit in range(places.size):
        others = np.delete(np.arange(places.size), unit)
        links |= {(unit, int(others[row])) for row in kept_links(places[others] - places[unit])}
    return links


@pytest.mark.parametrize("seed", range(20))
def test_kept_links_of_all_units_are_spanning_tree(seed) -> None:
    """Both ends agree. Links beyond SciPy's tree close a cycle of links of almost their length at least."""
    rng = np.random.default_rng(seed)
    places = rng.uniform(-5, 5, 9) + 1j * rng.uniform(-5, 5, 9)
    links = links_of(places)
    assert links == {(other, unit) for unit, other in links}
    apart = np.abs(places[:, None] - places)
    tree = minimum_spanning_tree(apart).toarray()
    tree_links = {(int(a), int(b)) for a, b in np.argwhere(tree + tree.T)}
    assert tree_links <= links
    assert len(links) <= len(tree_links) + 6
    for unit, other in links - tree_links:
        on_way = breadth_first_order(tree, unit, directed=False)[1]
        way = [other]
        while way[-1] != unit:
            way.append(int(on_way[way[-1]]))
        assert apart[way[1:], way[:-1]].max() >= (1 - TIE_SHARE) * apart[unit, other]


@pytest.mark.parametrize("seed", range(20))
def test_link_of_tree_is_kept_whatever_else_units_know(seed) -> None:
    """Each unit knows three others of eight only, and estimates distances with errors up to 2 %."""
    rng = np.random.default_rng([seed, 2])
    places = rng.uniform(-5, 5, 8) + 1j * rng.uniform(-5, 5, 8)
    tree = minimum_spanning_tree(np.abs(places[:, None] - places)).toarray()
    kept = 0
    for unit, other in np.concatenate([np.argwhere(tree), np.argwhere(tree.T)]):
        others = np.union1d(rng.choice(np.delete(np.arange(8), unit), 2, replace=False), [other])
        centers = (places[others] - places[unit]) * (1 + rng.uniform(-0.02, 0.02, others.size))
        kept += other in others[kept_links(centers)]
    assert kept == 2 * 7


@pytest.mark.parametrize("seed", range(20))
def test_velocity_within_links_is_nearest_feasible(seed) -> None:
    """Brute force: no feasible velocity of a grid of 0.01 m/s is nearer."""
    rng = np.random.default_rng([seed, 5])
    offsets, wanted = rng.uniform(-1, 1, (4, 2)), rng.uniform(-1, 1, 2)
    hold, gain = float(np.linalg.norm(offsets, axis=1).max()) * 1.1, 0.5
    lengths = np.linalg.norm(offsets, axis=1)
    normals, least = offsets / lengths[:, None], -gain * (hold - lengths) / 2
    taken = within_links(wanted, offsets, hold, gain)
    assert (normals @ taken >= least - 1e-9).all()
    axis = np.arange(-1.5, 1.5, 0.01)
    grid = np.stack(np.meshgrid(axis, axis), axis=-1).reshape(-1, 2)
    feasible = grid[(grid @ normals.T >= least).all(axis=1)]
    assert np.linalg.norm(taken - wanted) <= np.linalg.norm(feasible - wanted, axis=1).min() + 1e-9


def test_units_at_one_place_keep_their_link() -> None:
    assert kept_links(np.array([0j, 3 + 0j])).tolist() == [0, 1]
    assert kept_links(np.array([1 + 0j, 3 + 0j])).tolist() == [0]


def test_unit_between_overlong_links_flies_to_their_middle() -> None:
    """Links of 2 and 1.5 in opposite directions, with 1 to hold: no velocity shortens both."""
    offsets = np.array([[2.0, 0.0], [-1.5, 0.0]])
    np.testing.assert_allclose(within_links(np.ones(2), offsets, 1.0, 0.4), [0.4 * 0.25, 0.0])


def test_unit_at_place_of_another_keeps_its_velocity() -> None:
    np.testing.assert_array_equal(within_links(np.ones(2), np.zeros((1, 2)), 1.0, 1.0), [1.0, 1.0])


def flown_range(seed: int, *, keeps: bool) -> float:
    """Return the largest range that the units need for contact, in holds, during 60 s of random flight.

    Each wants to fly at 1 m/s in a direction of its own, and knows places that are 0.2 s old. At the start
    their links are 4 m long at most, and the hold is 5 m.
    """
    rng = np.random.default_rng([seed, 8])
    places = np.cumsum(4 * np.exp(1j * rng.uniform(-1, 1, 7)))
    wanted = to_points(np.exp(1j * rng.uniform(-np.pi, np.pi, 7)))
    longest, before = 0.0, [places] * 3
    for _ in range(600):
        now, velocities = places.copy(), wanted.copy()
        for unit in range(7):
            centers = np.delete(before[0] - places[unit], unit)
            offsets = to_points(centers[kept_links(centers)])
            if keeps:
                velocities[unit] = within_links(wanted[unit], offsets, 5.0, 0.5)
        places = places + 0.1 * to_complex(velocities)
        before = [*before[1:], now]
        needed = minimum_spanning_tree(squareform(pdist(to_points(places)))).toarray().max()
        longest = max(longest, float(needed) / 5.0)
    return longest


@pytest.mark.parametrize("seed", range(10))
def test_units_that_want_to_part_stay_connected(seed) -> None:
    """Within the range, of which the hold is a share."""
    assert flown_range(seed, keeps=True) <= 1 / HOLD_SHARE
    assert flown_range(seed, keeps=False) > 1 / HOLD_SHARE, "negative control"


@pytest.mark.parametrize(("range_sides", "leaves"), [(np.inf, True), (20.0, True), (10.0, False)])
def test_unit_leaves_others_only_within_range(make_detections, make_report, range_sides, leaves) -> None:
    """Its robots are on the right, and the other unit's image centre is 10 sides to the left.

    A side is a tenth of half an image.
    """
    points = np.array([0.9, 0.8 + 0.1j, 0.8 - 0.1j, 0.7])
    seen = make_detections(np.arange(4), CENTRE + HALF_PX * points, sides=np.full(4, 40.0))
    report = make_report(1, range(4), CENTRE + HALF_PX * (points + 1.0), [])
    flight = KeepInView(TEMPLATE, separation_sides=0.0, radio_range_sides=range_sides)
    speed = flight.command(seen, FlightTask(np.arange(4)), [report]).lateral_mps[0]
    assert (speed > 0) == leaves
    if not leaves:
        assert speed == pytest.approx((HOLD_SHARE - 1) / 2), "it shares the excess with the other unit"


@pytest.mark.slow
@pytest.mark.parametrize("keeps", [True, False])
def test_chain_with_neighbors_radio_keeps_connection(monkeypatch, keeps) -> None:
    """The same chain of eight units loses its connection if the units fly without regard to it."""
    if not keeps:
        law = import_module("skyherd.control.flight.keep_in_view")
        monkeypatch.setattr(law, "within_links", lambda velocity_mps, *_: velocity_mps)
    tree = random_mission(4, Crowd(8, 8, "chain"))

    def needed_m(places_m: np.ndarray) -> float:
        return float(minimum_spanning_tree(squareform(pdist(np.asarray(places_m)))).toarray().max())

    range_m = 1.3 * needed_m([unit["position_m"] for unit in tree["units"]])
    tree |= {"network": {"range_m": range_m}, "duration_s": 150.0}
    longest_m = max(needed_m(step.fleet.positions_m) for step in run_steps(make_mission(tree)))
    assert (longest_m <= range_m) == keeps
