"""Result of a measurement on photographs: `photographs.json`, and tables of places as CSV."""

import csv
import io
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from skyherd.bench.result import Row
from skyherd.bench.set_result import SetResult
from skyherd.files.atomic import write_text
from skyherd.text import table_cell

RESULT, MISSED, UNCONFIRMED = "photographs.json", "missed.csv", "unconfirmed.csv"
"""File names in the folder of a result."""

PLACE_COLUMNS = ("set", "image", "id", "u_px", "v_px", "side_px", "found_by")
"""Columns of both tables of places."""


@dataclass(frozen=True)
class PhotographsResult(SetResult):
    """Content of `photographs.json`; its rows derive from `skyherd.bench.photographs.measurement.Count`."""

    def write_all(self, folder: Path, missed: Sequence[Row], unconfirmed: Sequence[Row]) -> None:
        """Write the result and the tables of places into a folder.

        Raises:
            OutputError: a file could not be written.
        """
        self.write(folder / RESULT)
        write_text(folder / MISSED, csv_text(missed, (*PLACE_COLUMNS, "missed_by")))
        write_text(folder / UNCONFIRMED, csv_text(unconfirmed, (*PLACE_COLUMNS, "kind")))


def csv_text(rows: Sequence[Row], columns: Sequence[str]) -> str:
    """Return rows as comma-separated values under a header line; texts pass `table_cell`."""
    text = io.StringIO()
    writer = csv.DictWriter(text, columns, lineterminator="\n")
    writer.writeheader()
    for row in rows:
        writer.writerow(
            {k: table_cell(value) if isinstance(value, str) else value for k, value in row.items()}
        )
    return text.getvalue()
