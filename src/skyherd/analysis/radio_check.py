"""Warnings about the radio links between units at the start of a mission, from ground truth."""

from collections.abc import Iterator

import numpy as np
from scipy.sparse.csgraph import connected_components, minimum_spanning_tree

from skyherd.analysis.views import views_of
from skyherd.datasets import Mission
from skyherd.geometry import BoolArray
from skyherd.sim.network import connected_parts
from skyherd.sim.physics import make_world
from skyherd.sim.world import World

MIN_COMMON_ROBOTS = 2
"""Robots that two units must see to know each other's place. Derived: two determine a similarity."""


def foresee_radio(mission: Mission) -> list[str]:
    """Return warnings about radio links, each a sentence without a full stop.

    They name units without contact at the start, and units that cannot keep the contact in flight. A mission
    whose units do not negotiate needs no radio between them.
    """
    scenario, world = mission.scenario, make_world(mission)
    in_range = world.in_range()
    if in_range is None or scenario.selection.kind == "radius":
        return []
    parts = connected_parts(in_range)
    if len(parts) > 1:
        units = " | ".join(", ".join(map(str, part)) for part in parts)
        return [
            f"units {units} cannot reach each other at the start (network.range_m = "
            f"{scenario.network.range_m:g}): each part forms its own tree until they are in range"
        ]
    return list(_of_links(mission, world, in_range))


def _of_links(mission: Mission, world: World, in_range: list[list[int]]) -> Iterator[str]:
    """Yield warnings about a team that is connected at the start."""
    scenario = mission.scenario
    if not scenario.network.relay and any(len(others) < len(in_range) for others in in_range):
        yield (
            "not every unit is in range of every other one, and network.relay is false: units out of range "
            "count as dead, and TC1-TC5 do not hold"
        )
    kinds = [unit.flight.kind for unit in scenario.units]
    if heedless := [unit for unit, kind in enumerate(kinds) if kind in ("follow", "perimeter")]:
        yield (
            f"units {', '.join(map(str, heedless))} may fly out of network.range_m; only flight.kind "
            '"keep-in-view" and "hover" keep the radio links'
        )
    places_m = world.fleet.positions_m
    links = np.argwhere(minimum_spanning_tree(np.linalg.norm(places_m[:, None] - places_m, axis=2)).toarray())
    views = views_of(mission, world.fleet, world.positions_m, world.headings_rad)
    group = _located(views.in_view)
    for unit, other in np.sort(links, axis=1).tolist():
        if group[unit] != group[other] and {kinds[unit], kinds[other]} != {"hover"}:
            yield (
                f"units {unit} and {other} may lose their radio link: they share fewer than "
                f"{MIN_COMMON_ROBOTS} robots in their images at the start, and do not know their distance"
            )


def _located(in_view: BoolArray) -> list[int]:
    """Return a number (U,) for each unit, equal for units that know each other's place.

    Args:
        in_view: (U, N) robots in the images of the units.
    """
    common = in_view.astype(np.int64) @ in_view.T >= MIN_COMMON_ROBOTS
    group: list[int] = connected_components(common)[1].tolist()
    return group
