"""The order of the protocol's rules: its effect, and the detection of wrong orders.

Each rule is safe by itself: TC3-TC5 hold in any order, as the tests of the protocol show with reversed rules.
The order makes a unit react in the image in which it receives information. In a wrong order the units of a
new tree search before it had a slot to grow in, and move while others rely on their views.
"""

from collections.abc import Sequence

import numpy as np
import pytest
from protocol_world import ProtocolWorld

from skyherd.control import AerialController, KeepInView, TreeProtocol, TreeSettings
from skyherd.control.tree.protocol import RULES, Transition
from skyherd.datasets import make_mission, random_mission
from skyherd.loop import run_steps
from skyherd.messages import NO_ID

NAMES = [transition.__name__ for transition, _ in RULES]
RULE = TreeSettings()


def ordered(names: Sequence[str]) -> tuple[tuple[Transition, str], ...]:
    return tuple(RULES[NAMES.index(name)] for name in names)


def moved_to_the_end(name: str) -> list[str]:
    return [*(other for other in NAMES if other != name), name]


def held_for_s(names: Sequence[str]) -> float:
    """Return the time for which all units hold their position after the founding, without shared robots."""
    rules = ordered(names)
    tree = random_mission(0) | {"perception": "ideal", "duration_s": 8.0}
    for unit in tree["units"]:
        unit["height_m"] = 0.5 * unit["height_m"]

    def controller(mission, unit):
        flight = KeepInView(mission.template, min_side_px=0.0)
        return AerialController(mission.template, TreeProtocol(RULE, rules=rules), flight)

    founded_s, still_s, before = np.inf, 0.0, None
    for step in run_steps(make_mission(tree), controller_for=controller):
        trees = (frame.decision.report.tree.tree_id for frame in step.frames.values())
        if any(tree_id != NO_ID for tree_id in trees):
            founded_s = min(founded_s, step.time_s)
        if before is not None and (step.fleet.heights_m == before).all():
            still_s = step.time_s
        before = step.fleet.heights_m
    return still_s - founded_s


def test_units_hold_position_for_a_slot_after_founding() -> None:
    assert held_for_s(NAMES) >= RULE.dwell_s


@pytest.mark.parametrize(
    "names",
    [
        pytest.param(NAMES[::-1], id="reversed"),
        pytest.param(moved_to_the_end("adopt_orphans"), id="adopt_orphans last"),
        pytest.param(moved_to_the_end("use_turns"), id="use_turns last"),
    ],
)
def test_wrong_rule_order_is_detected(names) -> None:
    assert held_for_s(names) < RULE.dwell_s


@pytest.mark.parametrize("names", [NAMES, NAMES[::-1]], ids=["as it is", "reversed"])
def test_any_rule_order_keeps_conditions(names) -> None:
    """Three units that see all of twelve robots: in P once formed, and again after a failure and a return."""
    rules = ordered(names)
    views = [{robot: 0.1 + 0.05 * robot for robot in range(12)} for _ in range(3)]
    world = ProtocolWorld(3, 12, RULE, views, make=lambda rule: TreeProtocol(rule, rules=rules))
    world.quiet(20.0)
    for event in (lambda unit: None, world.crash, world.revive):
        event(1)
        world.quiet(RULE.silence_s + 4 * RULE.dwell_s)
        assert world.in_p() and not world.edge_faults()


@pytest.mark.parametrize("name", ["receive_turns", "fail_over", "admit", "join_tree", "use_turns"])
def test_every_rule_is_necessary(name) -> None:
    """Without it the team of the test above is not formed, or not repaired."""
    with pytest.raises(AssertionError):
        test_any_rule_order_keeps_conditions([other for other in NAMES if other != name])


def test_every_rule_occurs_once_with_reason() -> None:
    assert len(set(NAMES)) == len(NAMES)
    assert all(len(reason.split()) > 3 for _, reason in RULES)
