"""Result of a measurement on sets of photographs: a row for each set and detector."""

import json
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from skyherd.bench.result import Row
from skyherd.bench.table import Table
from skyherd.files.atomic import write_text


@dataclass(frozen=True)
class SetResult:
    """Rows of a measurement, and selections for tables and plots.

    Attributes:
        environment: versions of programs, the machine, and the options of the run.
        rows: one for each set and detector that can read it.
        refused: reasons why a detector could not read a set, by the names of set and detector.
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
        """Return the row of a set and a detector; None if it could not read the set."""
        return next((r for r in self.rows if (r["set"], r["detector"]) == (set_name, detector)), None)

    def unread(self) -> dict[str, str]:
        """Return the reason why no detector can read a set, by the names of such sets."""
        read = {row["set"] for row in self.rows}
        return {
            name: next(iter(self.refused[name].values()), "none is chosen")
            for name in self.sets
            if name not in read
        }

    def tables_by_set(self, header: tuple[str, ...], cells: Callable[[Row], tuple[str, ...]]) -> list[Table]:
        """Return a table for each readable set, with a row of `cells` for each detector."""
        return [
            Table(name, "", header, tuple(cells(row) for row in self.rows if row["set"] == name))
            for name in self.sets
            if name not in self.unread()
        ]

    def refusals(self) -> list[tuple[str, str, str]]:
        """Return set, detector, and the reason why the detector cannot read the set."""
        return [(name, *pair) for name, of_set in self.refused.items() for pair in of_set.items()]

    def write(self, path: Path) -> Path:
        """Write the result as JSON, and return the path.

        Raises:
            OutputError: it could not be written.
        """
        return write_text(path, json.dumps(asdict(self), indent=1) + "\n")
