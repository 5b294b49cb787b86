"""The result of a measurement on photographs: `photographs.json`, and tables of places as CSV."""

import csv
import io
import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from skyherd.bench.result import Row
from skyherd.files.atomic import write_text

RESULT, MISSED, UNCONFIRMED = "photographs.json", "missed.csv", "unconfirmed.csv"
"""File names in the folder of a result."""

PLACE_COLUMNS = ("set", "image", "id", "u_px", "v_px", "side_px", "found_by")
"""Columns that both tables of places have."""


@dataclass(frozen=True)
class PhotographsResult:
    """What `photographs.json` holds.

    Attributes:
        environment: versions of programs, the machine, and the options of the run.
        rows: one for each set and detector (`skyherd.bench.photographs.measurement.Count`).
        refused: why a detector could not read a set, by the set's and the detector's names.
    """

    environment: dict[str, Any]
    rows: list[Row]
    refused: dict[str, dict[str, str]]

    @property
    def detectors(self) -> list[str]:
        """Names of the detectors, in the order measured."""
        return list(dict.fromkeys(row["detector"] for row in self.rows))

    @property
    def sets(self) -> list[str]:
        """Names of the sets, in the order measured."""
        return list(dict.fromkeys([*self.refused, *(row["set"] for row in self.rows)]))

    def row(self, set_name: str, detector: str) -> Row | None:
        """The row of a set and a detector; None if it could not read the set."""
        return next((r for r in self.rows if (r["set"], r["detector"]) == (set_name, detector)), None)

    def write(self, folder: Path, missed: Sequence[Row], unconfirmed: Sequence[Row]) -> None:
        """Write the result and the tables of places into a folder.

        Raises:
            OutputError: a file could not be written.
        """
        content = {"environment": self.environment, "rows": self.rows, "refused": self.refused}
        write_text(folder / RESULT, json.dumps(content, indent=1) + "\n")
        write_text(folder / MISSED, csv_text(missed, (*PLACE_COLUMNS, "missed_by")))
        write_text(folder / UNCONFIRMED, csv_text(unconfirmed, (*PLACE_COLUMNS, "kind")))


def csv_text(rows: Sequence[Row], columns: Sequence[str]) -> str:
    """Rows as comma-separated values below a line with the columns' names."""
    text = io.StringIO()
    writer = csv.DictWriter(text, columns, lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return text.getvalue()
