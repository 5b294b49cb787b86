"""Layout of markers on printable sheets, and parsing of ids and lengths. Lengths are in mm."""

import math
import re
from dataclasses import dataclass

from skyherd.errors import InputError
from skyherd.markers.dictionary import card_side, dictionary_size

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
"""Width and height of each paper, upright, mm. *Defined* by ISO 216 and ANSI Y14.1."""

UNITS_MM = {"mm": 1.0, "cm": 10.0, "m": 1000.0}
"""Millimetres in each unit of length. *Defined*."""

MARGIN_MM = 8.0
"""Empty margin on all sides, mm. *Chosen*: printers reach to about 5 mm from the paper's edge."""

RULER_MM = 14.0
"""Height of the footer with the ruler, mm. *Chosen*: fits a bar, its numbers and a line of text."""

STRIP_MM = 8.0
"""Height of the strip with id and arrow above a card, mm. *Chosen*: fits legible text."""

GAP_MM = 8.0
"""Gap between two cards, mm. *Derived*: fits the cut marks of both, 2 (3 + 0.8) mm, rounded up."""

ROUNDING = 1e-9
"""Added before a quotient of lengths is rounded down. *Chosen*: compensates the rounding of lengths that fit
exactly."""


@dataclass(frozen=True)
class Layout:
    """Positions of markers on a page.

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
        """Number of markers on a full page."""
        return self.columns * self.rows

    def corner_mm(self, place: int) -> tuple[float, float]:
        """Return the lower left corner, mm, of the card at a slot, counted by rows from the top.

        Measured from the page's lower left corner, y up.
        """
        row, column = divmod(place, self.columns)
        width = self.columns * self.card_mm + (self.columns - 1) * GAP_MM
        left = (self.page_mm[0] - width) / 2
        top = self.page_mm[1] - MARGIN_MM
        tall = self.card_mm + STRIP_MM
        return left + column * (self.card_mm + GAP_MM), top - tall - row * (tall + GAP_MM)


def parse_ids(text: str, dictionary: str, where: str = "ids") -> list[int]:
    """Parse ids such as `0-15,20`: each once, in the given order. `where` is their name in errors.

    Raises:
        InputError: the text is not a list of ids, or an id is not in the dictionary.
    """
    last = dictionary_size(dictionary) - 1
    ids: dict[int, None] = {}
    for part in text.split(","):
        match = re.fullmatch(r"\s*(\d{1,9})\s*(?:-\s*(\d{1,9})\s*)?", part)
        if match is None:
            raise InputError(where, f"{part.strip()!r} in {text!r}", "ids and ranges such as 0-15,20")
        first, end = int(match[1]), int(match[2] or match[1])
        if end < first:
            raise InputError(where, f"{part.strip()!r} runs backwards", f"write {end}-{first}")
        if end > last:
            raise InputError(
                where, f"{end} is not in {dictionary}", f"0 to {last}, or a larger `dictionary=`"
            )
        ids.update(dict.fromkeys(range(first, end + 1)))
    return list(ids)


def parse_length_mm(text: str, where: str) -> float:
    """Parse a length with its unit, such as `0.12m`, `12 cm` or `120mm`, into millimetres.

    `where` is its name in the error message.

    Raises:
        InputError: the text has no unit, or is not a positive length.
    """
    match = re.fullmatch(r"\s*([0-9]*\.?[0-9]+)\s*(mm|cm|m)\s*", text)
    length = float(match[1]) * UNITS_MM[match[2]] if match else 0.0
    if not length > 0:
        raise InputError(
            where, f"{text!r} is not a length", "a positive number and mm, cm or m, such as 0.12m"
        )
    return length


def _room_mm(page_mm: tuple[float, float]) -> tuple[float, float]:
    """Return the width and height of a page available to cards and strips."""
    return page_mm[0] - 2 * MARGIN_MM, page_mm[1] - 2 * MARGIN_MM - RULER_MM


def _count(room: float, size: float) -> int:
    return int((room + GAP_MM + ROUNDING) // (size + GAP_MM))


def max_side_mm(paper: str, dictionary: str) -> float:
    """Return the largest side, in whole mm, at which one marker fits a paper in either orientation."""
    width, height = PAPERS_MM[paper]
    rooms = [_room_mm(page) for page in ((width, height), (height, width))]
    return math.floor(
        max(min(wide, tall - STRIP_MM) for wide, tall in rooms) / card_side(dictionary) + ROUNDING
    )


def lay_out(paper: str, side_mm: float, dictionary: str) -> Layout:
    """Find the layout with most markers per page, in either orientation of the paper.

    `side_mm` is the side of the black squares.

    Raises:
        InputError: there is no such paper, or no marker fits it.
    """
    if paper not in PAPERS_MM:
        raise InputError("paper", f"no paper {paper!r}", f"one of {', '.join(PAPERS_MM)}")
    card_mm = side_mm * card_side(dictionary)
    width, height = PAPERS_MM[paper]
    layouts = []
    for page in ((width, height), (height, width)):
        wide, tall = _room_mm(page)
        layouts.append(
            Layout(
                page_mm=page,
                columns=_count(wide, card_mm),
                rows=_count(tall, card_mm + STRIP_MM),
                side_mm=side_mm,
                card_mm=card_mm,
            )
        )
    best = max(layouts, key=lambda layout: layout.per_page)
    if not best.per_page:
        sides = {name: max_side_mm(name, dictionary) for name in PAPERS_MM}
        larger = [name for name, side in sides.items() if side >= side_mm]
        raise InputError(
            "side",
            f"{side_mm:g} mm and its white margin do not fit {paper}",
            f"at most {sides[paper]:g} mm do" + (f"; {larger[0]} holds {side_mm:g} mm" if larger else ""),
        )
    return best
