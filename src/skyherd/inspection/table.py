"""Tables of detections and rejections: CSV, or JSON lines, with one row per marker.

Columns of detections: file; frame (of videos, from 0); time_s (of videos: the stream's own); id; u_px; v_px;
heading_deg (from +u to +v); side_px; the standard deviations of u, v and heading, empty where the detector
does not state them; and the corners, the first two ahead. JSON lines have the corners and the covariance of
(u px, v px, heading rad) as lists. With a known marker side, `skyherd.inspection.metres` adds columns.
"""

import csv
import json
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, TextIO, get_args

import numpy as np

from skyherd.files.atomic import whole_file
from skyherd.messages import Detections
from skyherd.messages.detections import CORNER_COLUMNS, MARKER_COLUMNS
from skyherd.text import printable, table_cell
from skyherd.vision import Reading, Rejection

Format = Literal["csv", "jsonl"]
FORMATS: tuple[Format, ...] = get_args(Format)
"""Formats of the tables: comma-separated values, and one JSON object a line."""

WHERE = ["file", "frame", "time_s"]
"""Columns that identify the image of a row, as the fields of `Place`."""

DETECTION_COLUMNS = [*WHERE, *MARKER_COLUMNS, *CORNER_COLUMNS]
"""Columns of the table of detections."""

READ = ["cell_px", "contrast", "blur_px", "tilt_deg", "likeness", "nearest_id", "wrong_cells"]
"""Columns of what a rejected candidate shows of a marker (`Reading`); empty of one without bits."""

AGAINST = ["against_marker", "against_chance", "against_rectangle", "against_grid"]
"""Columns of a candidate's log odds against each rival alone; empty where it was not compared."""

TESTED = ["quantity", "value", "limit"]
"""Columns of the quantity by which a candidate is rejected, and its limit; empty without one."""

REJECTION_COLUMNS = [
    *WHERE,
    "reason",
    *TESTED,
    "u_px",
    "v_px",
    "side_px",
    *READ,
    "log_odds",
    *AGAINST,
    *CORNER_COLUMNS,
    "words",
]
"""Columns of the table of rejections."""

Row = dict[str, Any]


@dataclass(frozen=True)
class Place:
    """Image that a row refers to.

    Attributes:
        file: name of the file.
        frame: number in a video, from 0; None for pictures.
        time_s: presentation time of the frame in a video; None for pictures.
    """

    file: str
    frame: int | None = None
    time_s: float | None = None


def detection_rows(place: Place, found: Detections, metric: Sequence[Row] = ()) -> Iterator[Row]:
    """Yield one row for each marker detected in an image.

    A covariance that is all zero means unknown; its columns are None. `metric` has further columns of each
    marker, or is empty.
    """
    for row, marker in enumerate(found):
        covariance = marker.covariance if marker.covariance.any() else None
        yield {
            **vars(place),
            **marker.columns(),
            "corners_px": marker.corners_px,
            "covariance": covariance,
            **(metric[row] if metric else {}),
        }


def rejection_rows(place: Place, rejections: Sequence[Rejection]) -> Iterator[Row]:
    """Yield one row for each rejected candidate of an image, with its measurements."""
    for rejection in rejections:
        yield {
            **vars(place),
            "reason": rejection.reason.value,
            **dict(zip(TESTED, _tested(rejection), strict=True)),
            "u_px": rejection.center_px[0],
            "v_px": rejection.center_px[1],
            "side_px": rejection.side_px,
            **dict.fromkeys(READ, None),
            **(_read(rejection.reading) if rejection.reading else {}),
            "log_odds": _finite(rejection.log_odds),
            **dict(zip(AGAINST, map(_finite, rejection.against.tolist()), strict=True)),
            "corners_px": rejection.corners_px,
            "words": rejection.words,
        }


def _finite(value: float) -> float | None:
    """Return a number, or None if it is not finite."""
    return value if np.isfinite(value) else None


def _read(reading: Reading) -> Row:
    """Return the columns `READ` of what a candidate shows of a marker."""
    return {
        "cell_px": reading.cell_px[0],
        "contrast": reading.contrast,
        "blur_px": reading.blur_cells * reading.cell_px.mean(),
        "tilt_deg": reading.tilt_deg,
        "likeness": reading.likeness,
        "nearest_id": reading.nearest_id,
        "wrong_cells": len(reading.wrong_cells),
    }


def _tested(rejection: Rejection) -> tuple[str, float, float] | tuple[None, None, None]:
    """Return name, value and limit of the quantity by which a candidate is rejected."""
    measured = rejection.measured
    return (None, None, None) if measured is None else (measured.name, measured.value, measured.limit)


class Table:
    """An open table to which rows are added; made by `open_table`."""

    def __init__(self, stream: TextIO, columns: list[str], kind: Format) -> None:
        self._stream, self._kind = stream, kind
        self._writer = csv.DictWriter(stream, columns, extrasaction="ignore", lineterminator="\n")
        if kind == "csv":
            self._writer.writeheader()

    def add(self, row: Row) -> None:
        """Write one row; CSV omits unknown keys, JSON lines keep them."""
        if self._kind == "csv":
            corners = dict(zip(CORNER_COLUMNS, np.ravel(row["corners_px"]), strict=True))
            self._writer.writerow(
                {key: _cell(value, _decimals(key)) for key, value in (row | corners).items()}
            )
        else:
            plain = {key: _short(value, _decimals(key)) for key, value in row.items()}
            self._stream.write(json.dumps(plain, ensure_ascii=False) + "\n")


def _decimals(column: str) -> int:
    """Return the decimals of a column, far below the errors of px and degrees, or of m and rad."""
    return 7 if column.endswith(("_m", "_rad", "_pose")) else 4


def _cell(value: Any, decimals: int) -> Any:
    """Return a CSV value; texts, such as arbitrary file names, are made harmless to spreadsheets."""
    return table_cell(value) if isinstance(value, str) else _short(value, decimals)


def _short(value: Any, decimals: int) -> Any:
    """Round numbers to decimals or, if small, to five digits; return arrays as lists, texts printable."""
    if isinstance(value, np.ndarray):
        return [_short(item, decimals) for item in value]
    if isinstance(value, str):
        return printable(value)
    if isinstance(value, float):
        return round(float(value), decimals) if abs(value) >= 0.1 else float(f"{value:.5g}")
    return value


@contextmanager
def open_table(path: Path, columns: list[str], kind: Format) -> Iterator[Table]:
    """Open a table for the body of a `with` statement; it gets its name when complete.

    If the body raises, nothing is left of the table.

    Args:
        path: path of the table; an existing file is replaced.
        columns: columns in order.
        kind: csv or jsonl.

    Raises:
        OutputError: it cannot be written.
    """
    with whole_file(path) as part, part.open("w", encoding="utf-8", newline="") as stream:
        yield Table(stream, columns, kind)
