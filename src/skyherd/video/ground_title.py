"""Title line above the ground in the video, with the state of the tree of units."""

from skyherd.analysis.tree_snapshot import TreeSnapshot
from skyherd.drawing.canvas import text_width

TITLE_SIZE_PX, STATE_SIZE_PX, TITLE_GAP_PX = 15, 13, 16
"""Font sizes of the title and of the tree's state, and the minimum gap between the two, px."""


def title_texts(tree: TreeSnapshot, width_px: float) -> tuple[str, str]:
    """Return the title and the state of the tree, as long as both fit side by side into a width, px.

    The title is shortened first, then dropped. Missing robots are counted if their ids do not fit.
    """
    for state in (_tree_text(tree), _tree_text(tree, counted=True)):
        room_px = width_px - text_width(state, STATE_SIZE_PX, bold=True) - TITLE_GAP_PX
        for title in ("the ground, metres", "metres", ""):
            if text_width(title, TITLE_SIZE_PX) <= room_px:
                return title, state
    return "", _tree_text(tree, counted=True)


def _tree_text(tree: TreeSnapshot, *, counted: bool = False) -> str:
    """Return the state of the tree in a few words, with units and robots named, or counted if `counted`."""
    living = len(tree.members) + len(tree.unjoined)
    parts = [f"{len(tree.members)} of {living} units in the tree"]
    if not tree.ready:
        parts.append("robots wait")
    if tree.dead:
        parts.append(f"dead: {_named(tree.dead, counted)}")
    if tree.missing_ids:
        parts.append(f"missing: {_named(tree.missing_ids, counted)}")
    return " · ".join(parts)


def _named(ids: frozenset[int], counted: bool) -> str:
    return f"{len(ids)}" if counted else ", ".join(str(number) for number in sorted(ids))
