"""Tree of units in the video: last statuses, and their drawing."""

from dataclasses import replace

import numpy as np
import pytest

from skyherd.analysis.tree_snapshot import TreeHistory, tree_snapshot
from skyherd.drawing.canvas import text_width
from skyherd.drawing.palette import unit_rgb
from skyherd.messages import NO_ID
from skyherd.messages.tree_status import TreeStatus
from skyherd.video.composer import Composer
from skyherd.video.ground_title import STATE_SIZE_PX, TITLE_SIZE_PX, title_texts
from skyherd.video.layout import make_layout
from skyherd.video.legend import ITEMS, TREE_ITEMS, legend_height_px, legend_items
from skyherd.video.tree_overlay import FLASH, FLASH_S, TreeOverlay

NONE = np.zeros(0, dtype=np.int64)


def word(*edges: tuple[int, int, tuple[int, int]], tree_id=0, asks_id=NO_ID, heir_id=NO_ID, ready=True):
    """Return a unit's status; an edge is (neighbour, turn, pair)."""
    return TreeStatus(
        tree_id=tree_id,
        asks_id=asks_id,
        ask_turn=-1,
        heir_id=heir_id,
        ready=ready,
        neighbor_ids=np.array([edge[0] for edge in edges], dtype=np.int64),
        turns=np.array([edge[1] for edge in edges], dtype=np.int64),
        pairs=np.array([edge[2] for edge in edges], dtype=np.int64).reshape(-1, 2),
        offered_ids=NONE,
        offered_to_ids=NONE,
        to_release_ids=NONE,
        missing_ids=NONE,
        handed_ids=NONE,
        handed_to_ids=NONE,
        handed_slots=NONE,
        accepted_ids=NONE,
    )


@pytest.mark.parametrize(("turns", "pair", "holder"), [((4, 5), (3, 4), 2), ((6, 5), (1, 2), 1)])
def test_later_turn_of_edge_wins(turns, pair, holder) -> None:
    """The lower unit holds even turns; a turn that was handed over is the other's."""
    state = tree_snapshot({1: word((2, turns[0], (1, 2))), 2: word((1, turns[1], (3, 4)))})
    link = state.links[1, 2]
    assert (link.pair, link.holder, link.is_mutual) == (pair, holder, True)


def test_edge_named_by_one_unit_has_no_pair() -> None:
    state = tree_snapshot({0: word((1, 1, (NO_ID, NO_ID))), 1: word(tree_id=NO_ID, asks_id=0)}, dead=[2])
    assert not state.links[0, 1].is_mutual
    assert state.links[0, 1].pair == ()
    assert (state.members, state.unjoined, state.dead) == ({0}, {1}, {2})
    assert state.asks == {1: 0}


def test_snapshot_pairs_match_shared_robots(ideal_failure) -> None:
    """At every step, the pair of each mutual edge is the intersection of the two sets."""
    mission, steps = ideal_failure
    watch, edges = TreeHistory(), 0
    for step in steps:
        tree = watch.add(step, mission.scenario.dead_units(step.time_s))
        for (j, k), link in tree.links.items():
            if link.is_mutual:
                common = np.intersect1d(step.control_sets[j], step.control_sets[k])
                assert list(link.pair) == common.tolist()
                edges += 1
    assert edges > 300


def test_exchanged_pair_flashes_temporarily() -> None:
    """Yellow appears at the change and disappears FLASH_S later; the units' colours stay."""
    units, robots = np.array([[40.0, 100.0], [260.0, 100.0]]), np.array([[150.0, 50.0], [150.0, 150.0]])
    view, seen = TreeOverlay(np.arange(2)), []
    for time_s in (0.0, FLASH_S + 0.1):
        image = np.full((200, 300, 3), 255, np.uint8)
        state = tree_snapshot({0: word((1, 0, (0, 1))), 1: word((0, 0, (0, 1)))})
        view.draw_edges(image, state, units, robots, time_s)
        seen.append([(image == color).all(axis=2).sum() for color in (FLASH, unit_rgb(0), unit_rgb(1))])
    assert seen[0][0] > 500 and seen[1][0] == 0
    assert min(seen[1][1:]) > 100


def test_dead_unit_has_no_picture_until_return(ideal_failure) -> None:
    mission, steps = ideal_failure
    composer = Composer(mission)
    box = make_layout((1600, 1000), [(800, 800)] * 5, legend_items(mission)).cameras[0]
    colored = {}
    for step in steps:
        if step.time_s in (20.0, 26.0):
            cell = box.of(composer.compose(step))
            colored[step.time_s] = (cell[40:] == unit_rgb(0)).all(axis=2).sum()
        elif step.time_s == steps[-1].time_s:
            break
    assert colored[20.0] > 1000 and colored[26.0] == 0


@pytest.mark.parametrize("units", range(1, 17))
def test_tree_legend_fits(units: int) -> None:
    items = ITEMS + TREE_ITEMS
    layout = make_layout((1600, 1000), [(480, 480)] * units, items)
    assert legend_height_px(layout.key.width, items) <= layout.key.height


@pytest.mark.parametrize(
    ("missing", "title", "state"),
    [
        (0, "the ground, metres", "1 of 1 units in the tree"),
        (3, "metres", "1 of 1 units in the tree · missing: 20, 21, 22"),
        (60, "the ground, metres", "1 of 1 units in the tree · missing: 60"),
    ],
)
def test_title_and_tree_state_do_not_overlap(missing, title, state) -> None:
    """In 440 px; ids that do not fit are counted."""
    tree = replace(tree_snapshot({0: word()}), missing_ids=frozenset(range(20, 20 + missing)))
    assert title_texts(tree, 440) == (title, state)
    assert text_width(title, TITLE_SIZE_PX) + text_width(state, STATE_SIZE_PX, bold=True) < 440
