"""Draw the state machine of an edge, docs/edge_states.svg: `python docs/scripts/make_edge_states.py`."""

from pathlib import Path
from typing import Any, NamedTuple

import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.patches import FancyArrowPatch, FancyBboxPatch

from skyherd.drawing.palette import INK, MUTED, PAPER, UNIT_COLORS
from skyherd.plots.style import drawing_style, new_figure

BLUE, ORANGE, GREEN = UNIT_COLORS[:3]
WIDE, HIGH = 2.5, 0.86
LINE: dict[str, Any] = {
    "arrowstyle": "-|>",
    "mutation_scale": 12,
    "color": INK,
    "linewidth": 1.1,
    "shrinkA": 1,
    "shrinkB": 1,
}


class State(NamedTuple):
    """State: name, meaning, position and colour."""

    name: str
    meaning: str
    x: float
    y: float
    color: str


class Arrow(NamedTuple):
    """Transition: source, target, cause, bend and label position."""

    start: str
    end: str
    text: str
    bend: float
    dx: float
    dy: float


STATES = (
    State("no edge", "", 0.0, 6.0, MUTED),
    State("asked", "outside; asks_id = k", 0.0, 3.6, MUTED),
    State("granted", "member; no pair yet", 5.6, 6.0, MUTED),
    State("turn mine", "may exchange the pair", 5.6, 3.6, BLUE),
    State("turn theirs", "keeps what it offered", 12.0, 3.6, GREEN),
    State("k silent", "longer than silence_s", 8.8, 1.2, ORANGE),
    State("heir", "has k's robots, edges", 3.4, -1.2, ORANGE),
    State("turned to heir", "edge to h, same pair", 13.0, -1.2, ORANGE),
)

ARROWS = (
    Arrow("no edge", "asked", "outside: k is the member with\nmost own robots in common", 0.0, 0.1, 0.0),
    Arrow("no edge", "granted", "member: k asks me;\noffer ≥ 2 robots, turn theirs", 0.0, 0.0, 0.4),
    Arrow("asked", "turn mine", "k's report: edge to me\nwithout a pair, robots offered", 0.0, 0.0, 0.4),
    Arrow("granted", "turn mine", "k's report: turn + 1,\nfirst pair", 0.0, 0.2, 0.0),
    Arrow("granted", "no edge", "k went elsewhere,\nor is silent", 0.32, 0.0, 1.35),
    Arrow("turn mine", "turn theirs", "hand over: turn + 1,\npair, robots offered", -0.25, 0.4, 1.25),
    Arrow("turn theirs", "turn mine", "k's report: turn + 1,\npair, robots offered", -0.25, 0.0, 0.0),
    Arrow(
        "turn mine",
        "turn mine",
        "at a slot: exchange the pair\nfor robots offered, if better",
        0.0,
        -2.3,
        -0.95,
    ),
    Arrow("turn mine", "k silent", "", 0.0, 0.0, 0.0),
    Arrow("turn theirs", "k silent", "", 0.0, 0.0, 0.0),
    Arrow("k silent", "heir", "k named me heir, or its heir is silent", 0.0, -2.3, 0.15),
    Arrow("k silent", "turned to heir", "k named h, who is alive:\nthe first turn is mine", 0.0, 2.1, 0.1),
)


def draw_state(axes: Axes, state: State) -> FancyBboxPatch:
    """Draw a rounded box with the state's name and meaning."""
    corner = state.x - WIDE / 2, state.y - HIGH / 2
    style = "round,pad=0.08,rounding_size=0.2"
    box = FancyBboxPatch(corner, WIDE, HIGH, style, facecolor=PAPER, edgecolor=state.color, linewidth=2.2)
    axes.add_patch(box)
    lift = 0.18 if state.meaning else 0.0
    axes.text(state.x, state.y + lift, state.name, ha="center", va="center", weight="bold", fontsize=10)
    axes.text(state.x, state.y - 0.2, state.meaning, ha="center", va="center", fontsize=7.5)
    return box


def draw_arrow(axes: Axes, arrow: Arrow, boxes: dict[str, FancyBboxPatch]) -> None:
    """Draw a labelled arrow between boxes; a loop is drawn below its box."""
    places = {state.name: (state.x, state.y) for state in STATES}
    start, end = places[arrow.start], places[arrow.end]
    if arrow.start == arrow.end:
        x, y = start
        start, end = (x - 0.75, y - HIGH / 2 - 0.1), (x - 0.15, y - HIGH / 2 - 0.1)
        link = FancyArrowPatch(start, end, connectionstyle="arc3,rad=1.3", **LINE)
    else:
        link = FancyArrowPatch(
            start,
            end,
            connectionstyle=f"arc3,rad={arrow.bend}",
            patchA=boxes[arrow.start],
            patchB=boxes[arrow.end],
            **LINE,
        )
    axes.add_patch(link)
    x, y = (start[0] + end[0]) / 2 + arrow.dx, (start[1] + end[1]) / 2 + arrow.dy
    aside = arrow.text != "" and start[0] == end[0]
    axes.text(x, y, arrow.text, ha="left" if aside else "center", va="center", fontsize=7.5)


def main() -> None:
    """Draw all states and arrows."""
    with drawing_style():
        mpl.rcParams["svg.fonttype"] = "path"
        figure = new_figure(5.9, 10.2)
        axes = figure.subplots()
        boxes = {state.name: draw_state(axes, state) for state in STATES}
        for arrow in ARROWS:
            draw_arrow(axes, arrow, boxes)
        axes.set(xlim=(-1.6, 15.0), ylim=(-2.0, 8.0), aspect="equal")
        axes.axis("off")
        figure.savefig(Path(__file__).parent.parent / "edge_states.svg", metadata={"Date": None})


if __name__ == "__main__":
    main()
