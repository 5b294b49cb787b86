"""Line and marker styles of detectors in figures; skyherd's own stand out."""

from collections.abc import Sequence
from typing import Any

from skyherd.bench.entrants import is_ours
from skyherd.drawing.palette import INK, MUTED, UNIT_COLORS

OUR_COLORS = (UNIT_COLORS[0], UNIT_COLORS[1], INK, UNIT_COLORS[2])
OTHER_COLORS = (UNIT_COLORS[7], UNIT_COLORS[4], UNIT_COLORS[5], UNIT_COLORS[3], UNIT_COLORS[2], MUTED)
"""Colours of skyherd's own detectors and of the others, in the result's order."""

MARKS = "osD^vPX<>*"
"""Matplotlib markers of the detectors."""


def style_of(names: Sequence[str], name: str) -> dict[str, Any]:
    """Return the line style of a detector: solid for skyherd's own, dashed for the others.

    Lines of own detectors become narrower one by one, so that coincident lines all remain visible.
    """
    same = [other for other in names if is_ours(other) == is_ours(name)]
    index, ours = same.index(name), is_ours(name)
    colors = OUR_COLORS if ours else OTHER_COLORS
    return {
        "color": colors[index % len(colors)],
        "linestyle": "-" if ours else "--",
        "linewidth": max(3.2 - 0.9 * index, 1.2) if ours else 1.2,
        "marker": MARKS[(index if ours else index + 4) % len(MARKS)],
        "markersize": max(7.5 - 1.5 * index, 4.0) if ours else 4.5,
    }
