"""Legend of the video: symbols and their meanings."""

from collections.abc import Callable, Sequence

import numpy as np

from skyherd.datasets import Mission
from skyherd.drawing.canvas import (
    circle_dashes,
    dashes,
    draw_arrows,
    draw_circle,
    draw_lines,
    draw_ring,
    draw_segments,
    draw_text,
    text_width,
)
from skyherd.drawing.palette import INK, MUTED, PAPER, TEMPLATE_COLOR, rgb, unit_rgb
from skyherd.geometry import RgbImage
from skyherd.video.body_overlay import CLEAR, draw_bodies, draw_obstacle
from skyherd.video.camera_panel import FOREIGN
from skyherd.video.tree_overlay import FLASH, draw_dead, draw_link, draw_turn

SYMBOL_PX = 38
"""Width of a symbol, px."""

ROW_PX, TIGHT_PX, MANY = 23, 21, 12
"""Height of a row, px; the lower one in a legend of more than `MANY` symbols."""

TEXT_PX = 12
"""Size of the text."""

FIRST, SECOND = unit_rgb(0), unit_rgb(1)
"""Colours of the two example units of the symbols."""

Symbol = Callable[[RgbImage, float, float], None]
"""Function that draws a symbol around a point (u, v)."""

Item = tuple[Symbol, str]
"""A symbol and its meaning."""


def _mine(image: RgbImage, u: float, v: float) -> None:
    draw_ring(image, (u, v), 6, [FIRST], 2)


def _shared(image: RgbImage, u: float, v: float) -> None:
    draw_ring(image, (u, v), 5, [FIRST], 2)
    draw_ring(image, (u, v), 9, [SECOND], 2)


def _foreign(image: RgbImage, u: float, v: float) -> None:
    draw_ring(image, (u, v), 6, [FOREIGN], 2)


def _goal(image: RgbImage, u: float, v: float) -> None:
    draw_arrows(image, [(u - 13, v)], [(u + 13, v)], rgb(TEMPLATE_COLOR), rgb(PAPER))


def _radius(image: RgbImage, u: float, v: float) -> None:
    draw_lines(image, circle_dashes((u, v), 9, 3), rgb(MUTED), 2)


def _robot(image: RgbImage, u: float, v: float) -> None:
    draw_ring(image, (u, v), 8, [FIRST, SECOND], 3)


def _shape(image: RgbImage, u: float, v: float) -> None:
    draw_segments(image, *dashes([[u - 13, v]], [[u + 4, v]]), rgb(TEMPLATE_COLOR))
    draw_circle(image, (u + 8, v), 5, rgb(TEMPLATE_COLOR), 1)


def _outline(image: RgbImage, u: float, v: float) -> None:
    draw_lines(image, [[[u - 13, v + 5], [u, v - 6], [u + 13, v + 5]]], rgb(TEMPLATE_COLOR), 3)


def _unit(image: RgbImage, u: float, v: float) -> None:
    square = [[u - 9, v - 9], [u + 9, v - 9], [u + 9, v + 9], [u - 9, v + 9]]
    draw_lines(image, [square], FIRST, 2, closed=True)
    draw_lines(image, [[[u - 4, v], [u + 4, v]], [[u, v - 4], [u, v + 4]]], FIRST, 2)


ITEMS: tuple[Item, ...] = (
    (_mine, "controlled by this unit"),
    (_shared, "shared with another unit"),
    (_foreign, "seen, not controlled"),
    (_goal, "to the desired point"),
    (_radius, "safety radius"),
    (_robot, "coloured by its units"),
    (_outline, "desired shape"),
    (_shape, "its point in the shape"),
    (_unit, "unit and its view"),
)
"""Symbols of videos of several units with an outline of the shape."""


def _edge(image: RgbImage, u: float, v: float) -> None:
    ends = np.array([[u - 15, v], [u + 15, v]])
    draw_link(image, ends, np.array([[u, v - 8], [u, v + 8]]), (0, 1))
    draw_turn(image, (u - 8, v), FIRST)


def _exchange(image: RgbImage, u: float, v: float) -> None:
    draw_circle(image, (u, v), 10, FLASH, -1)
    draw_ring(image, (u, v), 6, [FIRST, SECOND], 3)


def _granted(image: RgbImage, u: float, v: float) -> None:
    draw_segments(image, *dashes([[u - 15, v]], [[u + 15, v]]), rgb(MUTED), 2)


def _dead(image: RgbImage, u: float, v: float) -> None:
    draw_dead(image, (u, v), 6, rgb(MUTED))


TREE_ITEMS: tuple[Item, ...] = (
    (_edge, "edge: shared pair and turn"),
    (_exchange, "pair just exchanged"),
    (_granted, "edge known to one unit"),
    (_dead, "dead unit"),
)
"""Additional symbols with a tree of units, the last one with outages."""


def _safety(image: RgbImage, u: float, v: float) -> None:
    draw_circle(image, (u, v), 10, CLEAR, -1)
    draw_bodies(image, np.array([[u, v]]), 6, np.zeros(1, dtype=bool))


def _overlap(image: RgbImage, u: float, v: float) -> None:
    draw_bodies(image, np.array([[u - 5, v], [u + 5, v]]), 6, np.ones(2, dtype=bool))


def _obstacle(image: RgbImage, u: float, v: float) -> None:
    draw_obstacle(image, np.array([u, v]), 9, 0, struck=False)


def _exchanged(image: RgbImage, u: float, v: float) -> None:
    draw_segments(image, *dashes([[u - 13, v]], [[u + 4, v]]), rgb(TEMPLATE_COLOR), 3)
    draw_circle(image, (u + 8, v), 6, rgb(TEMPLATE_COLOR), -1)


BODY_ITEMS: tuple[Item, ...] = (
    (_safety, "body and safety margin"),
    (_overlap, "bodies that overlap"),
    (_obstacle, "obstacle"),
    (_exchanged, "place just exchanged"),
)
"""Additional symbols where robots have bodies, or may exchange roles."""


def legend_items(mission: Mission) -> tuple[Item, ...]:
    """Return the symbols that can occur in the video of a mission."""
    scenario = mission.scenario
    bodies = bool(scenario.robots.body_radius_sides or scenario.obstacles)
    occurs: dict[Symbol, bool] = {
        _shared: len(scenario.units) > 1,
        _outline: any(mission.outlines),
        _dead: any(unit.outages for unit in scenario.units),
        _edge: scenario.selection.kind != "radius" and len(scenario.units) > 1,
        _exchange: scenario.selection.kind != "radius" and len(scenario.units) > 1,
        _granted: scenario.selection.kind != "radius" and len(scenario.units) > 1,
        _safety: bodies and scenario.avoidance.on,
        _overlap: bodies and not scenario.avoidance.on,
        _obstacle: bool(scenario.obstacles),
        _exchanged: scenario.roles.exchange,
    }
    items = (*ITEMS, *TREE_ITEMS, *BODY_ITEMS)
    return tuple((draw, text) for draw, text in items if occurs.get(draw, True))


def legend_height_px(width_px: int, items: Sequence[Item]) -> int:
    """Return the height of the legend in a panel of this width, px."""
    _, rows, row_px = _grid(width_px, items)
    return rows * row_px


def _grid(width_px: int, items: Sequence[Item]) -> tuple[float, int, int]:
    """Return column width, px, number of rows, and row height, px."""
    pitch = SYMBOL_PX + max(text_width(text, TEXT_PX) for _, text in items) + 6
    columns = min(len(items), max(1, int(width_px // pitch)))
    return pitch, -(-len(items) // columns), TIGHT_PX if len(items) > MANY else ROW_PX


def draw_legend(panel: RgbImage, items: Sequence[Item]) -> None:
    """Draw the legend into a panel of the canvas, in as many columns as fit."""
    pitch, rows, row_px = _grid(panel.shape[1], items)
    for k, (draw, text) in enumerate(items):
        u, v = k // rows * pitch + SYMBOL_PX / 2, (k % rows + 0.5) * row_px
        draw(panel, u, v)
        draw_text(panel, text, (u + SYMBOL_PX / 2 + 2, v), rgb(INK), size_px=TEXT_PX)
