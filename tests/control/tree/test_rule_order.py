"""The order of the protocol's rules matters, and a wrong one does not go unnoticed."""

import numpy as np
from protocol_world import ProtocolWorld

from skyherd.control import TreeProtocol, TreeRule
from skyherd.control.tree.protocol import Transition

RULE = TreeRule()
STEP_S = 0.5
UNITS, ROBOTS = 3, 12

Rules = tuple[tuple[Transition, str], ...]


def everything(robots: int) -> dict[int, float]:
    """A view of all robots, well inside."""
    return {robot: 0.1 + 0.7 * robot / robots for robot in range(robots)}


def world_of(rules: Rules, seed: int) -> ProtocolWorld:
    """Three units that see most of twelve robots, at distances drawn from the seed."""
    rng = np.random.default_rng(seed)
    views = []
    for _ in range(UNITS):
        at = rng.uniform(0.1, 1.1, ROBOTS)
        views.append({robot: float(at[robot]) for robot in range(ROBOTS) if rng.random() < 0.8})
    return ProtocolWorld(UNITS, ROBOTS, RULE, views, make=lambda rule: TreeProtocol(rule, rules=rules))


def faults(rules: Rules, seed: int) -> list[str]:
    """What goes wrong in half a minute in which views change, letters are late and a unit dies and returns.

    While all live, every unit hears every other one once in a silence, so that nobody may lose a robot that
    is seen, and no two units may share anything but the pair of their edge. After the death TC1-TC5 must hold
    again within a silence, the dead unit's slots and an image; after its return as well.
    """
    rng = np.random.default_rng([seed, 1])
    world, found = world_of(rules, seed), []
    world.quiet(12.0, STEP_S)
    settled = set(world.holders())
    for _ in range(40):
        world.time_s = round(world.time_s + STEP_S, 3)
        for unit in rng.permutation(UNITS).tolist():
            robot = int(rng.integers(ROBOTS))
            world.views[unit][robot] = float(rng.uniform(0.1, 1.1))
            if rng.random() < 0.7:
                world.deliver_to(unit)
            world.image(unit)
            found += [f"{world.time_s} s: {fault}" for fault in world.edge_faults()]
        lost = settled - set(world.holders())
        if lost:
            found.append(f"{world.time_s} s: nobody controls {sorted(lost)}")
    world.views[:] = [everything(ROBOTS) for _ in range(UNITS)]
    world.quiet(2 * RULE.dwell_s + RULE.silence_s, STEP_S)
    dead = int(rng.integers(UNITS))
    for event in (world.crash, world.revive):
        event(dead)
        world.quiet(RULE.silence_s + 3 * RULE.dwell_s, STEP_S)
        for _ in range(4):
            if not world.in_p():
                found.append(f"{world.time_s} s: not in P after {event.__name__}")
            found += [f"{world.time_s} s: {fault}" for fault in world.edge_faults()]
            world.quiet(STEP_S, STEP_S)
    return found
