"""Colours of the project: of units, distinct for colour-blind readers, and a few others."""

from functools import cache

UNIT_COLORS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#F0E442", "#666666")
"""Colours of units, in their order (Okabe and Ito 2008, "Color Universal Design")."""

INK = "#1b1f24"
"""Text and outlines."""

PAPER = "#ffffff"
"""Background."""

MUTED = "#8a9099"
"""Background elements: axes, notes."""

TEMPLATE_COLOR = "#7a3db8"
"""Desired shape."""

WARNING = "#a50026"
"""Warnings: darker than all of the above except ink, to stand out without its hue."""


def unit_color(unit: int) -> str:
    """Return the colour of a unit as `#rrggbb`; colours repeat after eight units."""
    return UNIT_COLORS[unit % len(UNIT_COLORS)]


def unit_rgb(unit: int) -> tuple[int, int, int]:
    """Return the colour of a unit as 8-bit RGB."""
    return rgb(unit_color(unit))


@cache
def rgb(color: str) -> tuple[int, int, int]:
    """Convert a `#rrggbb` colour to 8-bit RGB."""
    return int(color[1:3], 16), int(color[3:5], 16), int(color[5:7], 16)
