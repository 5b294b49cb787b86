"""Printable marker sheets: a vector PDF at true size.

Every marker lies on its white card, a quiet zone wide, below a strip with its id and an arrow that points
forward: the marker's row 0 is at the top. Cut marks stand at the corners of card and strip and where the two
meet. A ruler at the foot of each page tells whether it was printed at true size.
"""

import math
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import matplotlib
from matplotlib.axes import Axes
from matplotlib.backends.backend_pdf import PdfPages
from matplotlib.figure import Figure
from matplotlib.patches import PathPatch, Polygon, Rectangle
from matplotlib.path import Path as Outline

from skyherd.drawing.palette import INK, MUTED, PAPER
from skyherd.errors import InputError
from skyherd.files.atomic import write_whole
from skyherd.markers.dictionary import (
    QUIET_ZONE_CELLS,
    card_side,
    cells_per_side,
    dictionary_size,
    marker_cells,
)

PAPERS_MM = {
    "A5": (148.0, 210.0),
    "A4": (210.0, 297.0),
    "A3": (297.0, 420.0),
    "A2": (420.0, 594.0),
    "A1": (594.0, 841.0),
    "A0": (841.0, 1189.0),
    "Letter": (215.9, 279.4),
    "Legal": (215.9, 355.6),
    "Tabloid": (279.4, 431.8),
}
"""Width and height of each paper, upright."""

UNITS_MM = {"mm": 1.0, "cm": 10.0, "m": 1000.0}
MARGIN_MM = 8.0
"""Few printers reach the paper's edge."""

RULER_MM = 14.0
"""Height of the foot that holds the ruler."""

STRIP_MM = 8.0
GAP_MM = 8.0
"""Between markers: room for the cut marks of both."""

MARK_MM, MARK_OFFSET_MM = 3.0, 0.8
MM_PER_INCH = 25.4
FONT_PT = 8.0


@dataclass(frozen=True)
class Layout:
    """Where markers lie on a page.

    Attributes:
        page_mm: width and height, as the paper is turned.
        columns: markers side by side.
        rows: markers one above the other.
        side_mm: side of the black square.
        card_mm: side of the white card.
    """

    page_mm: tuple[float, float]
    columns: int
    rows: int
    side_mm: float
    card_mm: float

    @property
    def per_page(self) -> int:
        """Markers on a full page."""
        return self.columns * self.rows

    def corner_mm(self, place: int) -> tuple[float, float]:
        """Lower left corner of the card at a place of the page, from the page's lower left corner, y up."""
        row, column = divmod(place, self.columns)
        width = self.columns * self.card_mm + (self.columns - 1) * GAP_MM
        left = (self.page_mm[0] - width) / 2
        top = self.page_mm[1] - MARGIN_MM
        tall = self.card_mm + STRIP_MM
        return left + column * (self.card_mm + GAP_MM), top - tall - row * (tall + GAP_MM)


def parse_ids(text: str, dictionary: str) -> list[int]:
    """Ids of `0-15,20`, each once, in the order given.

    Raises:
        InputError: that is no list of ids, or one is not in the dictionary.
    """
    last = dictionary_size(dictionary) - 1
    ids: dict[int, None] = {}
    for part in text.split(","):
        match = re.fullmatch(r"\s*(\d+)\s*(?:-\s*(\d+)\s*)?", part)
        if match is None:
            raise InputError("--ids", f"{part.strip()!r} in {text!r}", "ids and ranges such as 0-15,20")
        first, end = int(match[1]), int(match[2] or match[1])
        if end < first:
            raise InputError("--ids", f"{part.strip()!r} runs backwards", f"write {end}-{first}")
        if end > last:
            raise InputError(
                "--ids", f"{end} is not in {dictionary}", f"0 to {last}, or a larger --dictionary"
            )
        ids.update(dict.fromkeys(range(first, end + 1)))
    return list(ids)


def parse_length_mm(text: str, where: str) -> float:
    """Millimetres of a length with its unit: `0.12m`, `12 cm`, `120mm`.

    Raises:
        InputError: it has no unit, or is not a positive length.
    """
    match = re.fullmatch(r"\s*([0-9]*\.?[0-9]+)\s*(mm|cm|m)\s*", text)
    length = float(match[1]) * UNITS_MM[match[2]] if match else 0.0
    if not length > 0:
        raise InputError(where, f"{text!r} is no length", "a positive number and mm, cm or m, such as 0.12m")
    return length


def _room_mm(page_mm: tuple[float, float]) -> tuple[float, float]:
    """Width and height of a page that cards and strips may take."""
    return page_mm[0] - 2 * MARGIN_MM, page_mm[1] - 2 * MARGIN_MM - RULER_MM


def _count(room: float, size: float) -> int:
    return int((room + GAP_MM + 1e-9) // (size + GAP_MM))


def largest_side_mm(paper: str, dictionary: str) -> float:
    """Largest side, in whole millimetres, of which one marker fits the paper."""
    width, height = PAPERS_MM[paper]
    rooms = [_room_mm(page) for page in ((width, height), (height, width))]
    return math.floor(max(min(wide, tall - STRIP_MM) for wide, tall in rooms) / card_side(dictionary) + 1e-9)


def lay_out(paper: str, side_mm: float, dictionary: str) -> Layout:
    """The layout with most markers a page, the paper upright or turned.

    Raises:
        InputError: there is no such paper, or not one marker fits it.
    """
    if paper not in PAPERS_MM:
        raise InputError("--paper", f"no paper {paper!r}", f"one of {', '.join(PAPERS_MM)}")
    card_mm = side_mm * card_side(dictionary)
    width, height = PAPERS_MM[paper]
    layouts = []
    for page in ((width, height), (height, width)):
        wide, tall = _room_mm(page)
        layouts.append(
            Layout(page, _count(wide, card_mm), _count(tall, card_mm + STRIP_MM), side_mm, card_mm)
        )
    best = max(layouts, key=lambda layout: layout.per_page)
    if not best.per_page:
        sides = {name: largest_side_mm(name, dictionary) for name in PAPERS_MM}
        larger = [name for name, side in sides.items() if side >= side_mm]
        raise InputError(
            "--side",
            f"{side_mm:g} mm and its white margin do not fit {paper}",
            f"at most {sides[paper]:g} mm do" + (f"; {larger[0]} holds {side_mm:g} mm" if larger else ""),
        )
    return best


def draw_pages(ids: Sequence[int], layout: Layout, dictionary: str) -> Iterator[Figure]:
    """The pages as figures of the paper's size."""
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
    # All white cells are one shape: between neighbours no hairline shows.
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
    """The strip ahead of the card: arrow, id, and what it is if there is room."""
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
    """Marks outside the corners of card and strip, and beside the line between them."""
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
    """A bar of whole centimetres at the foot of the page, and what to do with it."""
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
    """Write a PDF of the markers, whole or not at all; returns how they lie.

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
