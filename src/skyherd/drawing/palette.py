"""The project's colours: of units, which colour-blind people tell apart too, and a few others."""

from functools import cache

UNIT_COLORS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#F0E442", "#666666")
"""Colours of units, in their order (Okabe and Ito 2008, "Color Universal Design")."""

INK = "#1b1f24"
"""Text and outlines."""

PAPER = "#ffffff"
"""Background."""

MUTED = "#8a9099"
"""What should stay in the background: axes, notes."""

TEMPLATE_COLOR = "#7a3db8"
"""The shape to form."""

WARNING = "#a50026"
"""Warnings: darker than all of the above but ink, so that it stands out without its hue, too."""


def unit_color(unit: int) -> str:
    """Colour of a unit as `#rrggbb`; colours repeat after eight units."""
    return UNIT_COLORS[unit % len(UNIT_COLORS)]


def unit_rgb(unit: int) -> tuple[int, int, int]:
    """Colour of a unit as 8-bit RGB."""
    return rgb(unit_color(unit))


@cache
def rgb(color: str) -> tuple[int, int, int]:
    """8-bit RGB of a `#rrggbb` colour."""
    return int(color[1:3], 16), int(color[3:5], 16), int(color[5:7], 16)
