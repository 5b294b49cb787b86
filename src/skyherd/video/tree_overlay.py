"""The tree of units drawn over the ground: edges, shared pairs, whose turn it is, what was just exchanged."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from skyherd.analysis.tree_snapshot import Ends, Link, TreeSnapshot
from skyherd.drawing.canvas import Color, Image, dashes, draw_circle, draw_lines, draw_ring, draw_segments
from skyherd.drawing.palette import INK, MUTED, PAPER, rgb, unit_rgb
from skyherd.geometry import Array, IntArray

FLASH_S = 2.0
"""How long an exchanged pair is shown as new."""

FLASH: Color = (255, 205, 40)
TURN_AT = 0.28
"""Where on an edge the mark of the turn is, from the unit that has it."""


@dataclass
class TreeOverlay:
    """Draws the tree of each step; `ids` are the robots in the order of their places."""

    ids: IntArray
    _pairs: dict[Ends, tuple[int, ...]] = field(default_factory=dict, init=False)
    _changed_s: dict[Ends, float] = field(default_factory=dict, init=False)

    def draw_edges(
        self, image: Image, tree: TreeSnapshot, units: Array, robots: Array, time_s: float
    ) -> None:
        """Edges between the units' places (U, 2), with the pairs among the robots' places (N, 2)."""
        self._watch(tree, time_s)
        for ends, link in tree.links.items():
            places = units[list(ends)]
            if not link.is_mutual or not link.pair:
                draw_segments(image, *dashes(places[:1], places[1:], 5.0), rgb(MUTED), 2)
                continue
            pair = robots[np.searchsorted(self.ids, link.pair)]
            if time_s < self._changed_s.get(ends, -np.inf) + FLASH_S:
                draw_lines(image, [places], FLASH, 11)
                _flash(image, pair)
            draw_link(image, places, pair, ends)
            at = places[0] + (places[1] - places[0]) * (TURN_AT if link.holder == ends[0] else 1 - TURN_AT)
            draw_turn(image, at.tolist(), unit_rgb(link.holder))
        for unit, asked in tree.asks.items():
            draw_segments(image, *dashes(units[[unit]], units[[asked]], 3.0), unit_rgb(unit), 1)

    def _watch(self, tree: TreeSnapshot, time_s: float) -> None:
        """Note pairs that are not what they were."""
        pairs = {ends: link.pair for ends, link in tree.links.items() if link.pair}
        for ends, pair in pairs.items():
            if self._pairs.get(ends) != pair:
                self._changed_s[ends] = time_s
        self._pairs = pairs


def draw_link(image: Image, units: Array, pair: Array, ends: Ends) -> None:
    """An edge, half in each unit's colour, and thin lines by way of the two robots that it shares."""
    colors = [unit_rgb(unit) for unit in ends]
    middle = units.mean(axis=0)
    for unit, color in zip(units, colors, strict=True):
        draw_segments(image, np.broadcast_to(unit, pair.shape), pair, color, 1)
    draw_lines(image, [units], rgb(PAPER), 7)
    for unit, color in zip(units, colors, strict=True):
        draw_lines(image, [[unit, middle]], color, 4)


def draw_turn(image: Image, at: Sequence[float], color: Color) -> None:
    """The mark of the turn, in the colour of the unit that has it."""
    draw_circle(image, at, 6.5, rgb(PAPER), -1)
    draw_circle(image, at, 5.0, color, -1)
    draw_circle(image, at, 5.0, rgb(INK), 1)


def draw_pair_marks(
    image: Image, links: Mapping[Ends, Link], ids: IntArray, robots: Array, radius: float
) -> None:
    """Second, outer rings around shared robots, in the colours of the two units."""
    for ends, link in links.items():
        if not link.is_mutual:
            continue
        for place in robots[np.searchsorted(ids, link.pair)].tolist():
            draw_ring(image, place, radius + 5.5, [rgb(PAPER)], 3)
            draw_ring(image, place, radius + 4.5, [unit_rgb(unit) for unit in ends], 3)


def _flash(image: Image, pair: Array) -> None:
    for place in pair.tolist():
        draw_circle(image, place, 24.0, FLASH, -1)


def draw_dead(image: Image, at: Sequence[float], size_px: float, color: Color) -> None:
    """A slanted cross: something that is dead."""
    u, v = at
    s = size_px
    cross = [[[u - s, v - s], [u + s, v + s]], [[u - s, v + s], [u + s, v - s]]]
    draw_lines(image, cross, rgb(PAPER), 6)
    draw_lines(image, cross, color, 3)
