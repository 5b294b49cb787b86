"""Tree of units over the ground: edges, shared pairs, the unit whose turn it is, and new pairs."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from skyherd.analysis.tree_snapshot import Ends, Link, TreeSnapshot
from skyherd.drawing.canvas import Color, dashes, draw_circle, draw_lines, draw_ring, draw_segments
from skyherd.drawing.palette import INK, MUTED, PAPER, rgb, unit_rgb
from skyherd.geometry import Array, IntArray, RgbImage

FLASH_S = 2.0
"""Simulated time for which an exchanged pair is shown as new, s."""

FLASH: Color = (255, 205, 40)
"""Colour behind a new pair and its edge."""

TURN_AT = 0.28
"""Position of the turn's mark on an edge, as a share of its length from the unit that has the turn."""


@dataclass
class TreeOverlay:
    """Drawing of the tree step by step, in the order of time; `ids` (N,) are the robots, ascending."""

    ids: IntArray
    _pairs: dict[Ends, tuple[int, ...]] = field(default_factory=dict, init=False)
    _changed_s: dict[Ends, float] = field(default_factory=dict, init=False)

    def draw_edges(
        self, image: RgbImage, tree: TreeSnapshot, units: Array, robots: Array, time_s: float
    ) -> None:
        """Draw edges between units at (U, 2), and their pairs among robots at (N, 2), all px."""
        self._note_changes(tree, time_s)
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

    def _note_changes(self, tree: TreeSnapshot, time_s: float) -> None:
        """Note the time since which each edge has its current pair."""
        pairs = {ends: link.pair for ends, link in tree.links.items() if link.pair}
        for ends, pair in pairs.items():
            if self._pairs.get(ends) != pair:
                self._changed_s[ends] = time_s
        self._pairs = pairs


def draw_link(image: RgbImage, units: Array, pair: Array, ends: Ends) -> None:
    """Draw an edge, half in each unit's colour, and thin lines from both units to shared robots."""
    colors = [unit_rgb(unit) for unit in ends]
    middle = units.mean(axis=0)
    for unit, color in zip(units, colors, strict=True):
        draw_segments(image, np.broadcast_to(unit, pair.shape), pair, color, 1)
    draw_lines(image, [units], rgb(PAPER), 7)
    for unit, color in zip(units, colors, strict=True):
        draw_lines(image, [[unit, middle]], color, 4)


def draw_turn(image: RgbImage, at: Sequence[float], color: Color) -> None:
    """Draw the mark of the turn, in the colour of the unit that has it."""
    draw_circle(image, at, 6.5, rgb(PAPER), -1)
    draw_circle(image, at, 5.0, color, -1)
    draw_circle(image, at, 5.0, rgb(INK), 1)


def draw_pair_marks(
    image: RgbImage, links: Mapping[Ends, Link], ids: IntArray, robots: Array, radius: float
) -> None:
    """Draw a second, outer ring around each shared robot, in the colours of its two units."""
    for ends, link in links.items():
        if not link.is_mutual:
            continue
        for place in robots[np.searchsorted(ids, link.pair)].tolist():
            draw_ring(image, place, radius + 5.5, [rgb(PAPER)], 3)
            draw_ring(image, place, radius + 4.5, [unit_rgb(unit) for unit in ends], 3)


def _flash(image: RgbImage, pair: Array) -> None:
    for place in pair.tolist():
        draw_circle(image, place, 24.0, FLASH, -1)


def draw_dead(image: RgbImage, at: Sequence[float], size_px: float, color: Color) -> None:
    """Draw a slanted cross of half the width `size_px`: a unit in an outage."""
    u, v = at
    s = size_px
    cross = [[[u - s, v - s], [u + s, v + s]], [[u - s, v + s], [u + s, v - s]]]
    draw_lines(image, cross, rgb(PAPER), 6)
    draw_lines(image, cross, color, 3)
