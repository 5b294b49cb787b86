"""Printable marker sheets: a vector PDF at true size. Lengths are in millimetres.

Every marker lies on its white card, a quiet zone wide, below a strip with its id and an arrow that points
forward: the marker's row 0 is at the top. Cut marks are at the corners of card and strip and at their common
line. A ruler in the footer of each page verifies the printed size.
"""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import matplotlib
from matplotlib.axes import Axes
from matplotlib.backends.backend_pdf import PdfPages
from matplotlib.figure import Figure
from matplotlib.patches import PathPatch, Polygon, Rectangle
from matplotlib.path import Path as Outline

from skyherd.drawing.palette import INK, MUTED, PAPER
from skyherd.files.atomic import write_whole
from skyherd.markers.dictionary import QUIET_ZONE_CELLS, cells_per_side, marker_cells
from skyherd.markers.sheet_layout import MARGIN_MM, STRIP_MM, Layout, lay_out

MARK_MM, MARK_OFFSET_MM = 3.0, 0.8
"""Length of a cut mark, and its distance from the card, mm. *Chosen*: not visible after the cut."""

MM_PER_INCH = 25.4
"""Millimetres in an inch. *Defined*."""

FONT_PT = 8.0
"""Size of small text, points. *Chosen*: legible at arm's length."""


def draw_pages(ids: Sequence[int], layout: Layout, dictionary: str) -> Iterator[Figure]:
    """Draw the pages with markers `ids`, one after the other, as figures of the paper's size."""
    pages = [ids[k : k + layout.per_page] for k in range(0, len(ids), layout.per_page)]
    for number, page in enumerate(pages, start=1):
        width, height = layout.page_mm
        figure = Figure(figsize=(width / MM_PER_INCH, height / MM_PER_INCH))
        axes = figure.add_axes((0, 0, 1, 1))
        axes.set(xlim=(0, layout.page_mm[0]), ylim=(0, layout.page_mm[1]))
        axes.axis("off")
        for place, marker_id in enumerate(page):
            _draw_marker(axes, layout, layout.corner_mm(place), dictionary, marker_id)
        _draw_ruler(axes, layout, f"{dictionary}, page {number} of {len(pages)}")
        yield figure


def _draw_marker(
    axes: Axes, layout: Layout, corner_mm: tuple[float, float], dictionary: str, marker_id: int
) -> None:
    x, y = corner_mm
    n = cells_per_side(dictionary)
    cell = layout.side_mm / n
    left, bottom = x + QUIET_ZONE_CELLS * cell, y + QUIET_ZONE_CELLS * cell
    side = layout.side_mm
    axes.add_patch(Rectangle((left, bottom), side, side, facecolor="black", edgecolor="none", linewidth=0))
    rows, columns = marker_cells(dictionary, marker_id).nonzero()
    # All white cells are one shape, so that no hairline appears between neighbours.
    squares = [
        Outline([(u, v), (u + cell, v), (u + cell, v + cell), (u, v + cell), (u, v)], closed=True)
        for u, v in zip(left + columns * cell, bottom + (n - 1 - rows) * cell, strict=True)
    ]
    white = Outline.make_compound_path(*squares)
    axes.add_patch(PathPatch(white, facecolor="white", edgecolor="none", linewidth=0))
    _draw_strip(axes, layout, (x, y + layout.card_mm), f"{marker_id}", f"{dictionary}  {side:g} mm")
    _draw_cut_marks(axes, x, y, layout.card_mm)


def _draw_strip(
    axes: Axes, layout: Layout, corner_mm: tuple[float, float], marker_id: str, details: str
) -> None:
    """Draw the strip above the card: arrow, id, and a description if it fits."""
    x, y = corner_mm
    middle, height = x + layout.card_mm / 2, STRIP_MM
    arrow = [(-0.28, 0.15), (-0.1, 0.15), (-0.1, 0.45), (-0.28, 0.45), (0.0, 0.9)]
    points = [(u, v) for u, v in arrow[1:]] + [(-u, v) for u, v in arrow[-2:0:-1]]
    axes.add_patch(
        Polygon([(middle + u * height, y + v * height) for u, v in points], facecolor=INK, edgecolor="none")
    )
    style: dict[str, Any] = {"va": "center", "color": INK, "parse_math": False}
    axes.text(middle - 0.45 * height, y + height / 2, marker_id, ha="right", size=12, weight="bold", **style)
    if layout.card_mm / 2 - 0.45 * height > len(details) * FONT_PT * 0.62 / 72 * MM_PER_INCH:
        axes.text(middle + 0.45 * height, y + height / 2, details, ha="left", size=FONT_PT, **style)


def _draw_cut_marks(axes: Axes, x: float, y: float, card_mm: float) -> None:
    """Draw marks outside the corners of card and strip, and beside the line between them."""
    near, far = MARK_OFFSET_MM, MARK_OFFSET_MM + MARK_MM
    heights = (y, y + card_mm, y + card_mm + STRIP_MM)
    lines = [
        ((edge - s * near, edge - s * far), (h, h))
        for edge, s in ((x, 1), (x + card_mm, -1))
        for h in heights
    ]
    lines += [
        ((u, u), (edge - s * near, edge - s * far))
        for u in (x, x + card_mm)
        for edge, s in ((heights[0], 1), (heights[-1], -1))
    ]
    for u, v in lines:
        axes.plot(u, v, color=MUTED, linewidth=0.5, solid_capstyle="butt")


def _draw_ruler(axes: Axes, layout: Layout, text: str) -> None:
    """Draw a bar of whole centimetres in the page footer, with instructions."""
    room = layout.page_mm[0] - 2 * MARGIN_MM
    length = 100.0 if room >= 180 else 50.0
    x, y = MARGIN_MM, MARGIN_MM + 3.0
    for k in range(round(length / 10)):
        color = INK if k % 2 == 0 else PAPER
        axes.add_patch(Rectangle((x + 10 * k, y), 10, 2.5, facecolor=color, edgecolor=INK, linewidth=0.4))
    axes.text(x, y + 3.6, "0", size=FONT_PT, ha="center", va="bottom", color=INK)
    axes.text(x + length, y + 3.6, f"{length:g} mm", size=FONT_PT, ha="center", va="bottom", color=INK)
    note = f"print at 100 %; this bar must measure {length:g} mm"
    axes.text(x + length + 8, y + 2.6, note, size=FONT_PT, va="bottom", color=INK)
    axes.text(x + length + 8, y - 1.6, text, size=FONT_PT, va="bottom", color=MUTED)


def write_sheets(path: Path, ids: Sequence[int], side_mm: float, dictionary: str, paper: str) -> Layout:
    """Write a PDF with the markers `ids` atomically; return the layout of its pages.

    Raises:
        InputError: a marker does not fit the paper.
        OutputError: the file cannot be written.
    """
    layout = lay_out(paper, side_mm, dictionary)

    def write(part: Path) -> None:
        about = {"Title": f"{dictionary} markers of {side_mm:g} mm", "CreationDate": None, "ModDate": None}
        with matplotlib.rc_context({"pdf.fonttype": 42}), PdfPages(part, metadata=about) as pdf:
            for figure in draw_pages(ids, layout, dictionary):
                pdf.savefig(figure)

    write_whole(path, write)
    return layout
