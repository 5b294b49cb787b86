"""Put the main tables of a run of `skyherd bench detectors` into `docs/benchmark.md`, one figure a cell.

skyherd bench detectors --out runs/bench && python benchmarks/benchmark_doc.py runs/bench

`bench.md` of the run has all tables, also those of the other noises and of processing.
"""

import argparse
import shutil
from collections.abc import Iterator, Sequence
from pathlib import Path

from skyherd.bench.detectors.tables import make_tables
from skyherd.bench.result import read_result
from skyherd.bench.table import NONE, Table, markdown_page

DOC = Path(__file__).parent.parent / "docs" / "benchmark.md"
BEGIN, END = "<!-- measured: begin -->", "<!-- measured: end -->"
FIGURES = {"accuracy.png": "benchmark_accuracy.png", "times.png": "benchmark_times.png"}

SHOWN = ("photometric", "tracking", "opencv", "apriltag3", "locus-tag")
"""Detectors on the page. Chosen: OpenCV's other refinements are in `bench.md`."""

SIDES = ("10 px", "16 px", "20 px", "30 px", "60 px", "100 px")
"""Marker sides that have a column. Chosen: the figure shows all sides."""

FACTOR_COLUMNS = (
    ("photometric", (0, 1, 2)),
    ("opencv", (0, 2)),
)
"""Detectors of the table of factors, each with its columns: 0 position, 1 heading, 2 recall."""

QUANTITIES = ("position", "heading", "recall, %")

NOISE = "noise 5"
"""End of the titles of tables that exist for several noises, of which the page shows one."""


def split_pair(cell: str) -> tuple[str, str]:
    """Return position and heading of a cell such as `1.06 / 1.12`."""
    position, _, heading = cell.partition(" / ")
    return position, heading or NONE


def split_factor(cell: str) -> tuple[str, str, str]:
    """Return position, heading and recall in per cent of a cell such as `1.06 / 1.12, 100.0 %`."""
    pair, _, recall = cell.partition(", ")
    return *split_pair(pair), recall.removesuffix(" %") or NONE


def shown_rows(table: Table) -> list[tuple[str, ...]]:
    """Return the rows of the detectors on the page."""
    return [row for row in table.rows if row[0] in SHOWN]


def narrowed(table: Table) -> Table:
    """Return a table by marker side with the columns of `SIDES` only."""
    kept = [0, *(number for number, title in enumerate(table.header) if title in SIDES)]
    rows = tuple(tuple(row[number] for number in kept) for row in table.rows)
    return Table(table.title, table.note, tuple(table.header[number] for number in kept), rows)


def accuracy_tables(table: Table) -> Iterator[Table]:
    """Yield the errors of position and of heading, each as a table."""
    about = table.title.removeprefix("Error over the Cramér–Rao bound")
    for number, quantity in enumerate(QUANTITIES[:2]):
        rows = [(row[0], *(split_pair(cell)[number] for cell in row[1:])) for row in shown_rows(table)]
        yield Table(
            f"{quantity.capitalize()} error over the Cramér–Rao bound{about}",
            f"RMSE of the {quantity} of detected markers over its bound.",
            table.header,
            tuple(rows),
        )


def recall_table(table: Table) -> Table:
    """Return the recalls, the unit in the note."""
    rows = [(row[0], *(cell.removesuffix(" %") for cell in row[1:])) for row in shown_rows(table)]
    return Table(
        table.title, "Share of fully visible markers that are detected, %.", table.header, tuple(rows)
    )


def factor_table(table: Table) -> Table:
    """Return the table of factors with a column for each detector and quantity."""
    columns = [
        (table.header.index(name), name, number)
        for name, numbers in FACTOR_COLUMNS
        if name in table.header
        for number in numbers
    ]
    rows = [(row[0], *(split_factor(row[at])[number] for at, _, number in columns)) for row in table.rows]
    return Table(
        table.title,
        "Errors are RMSE over the bound. Occluded markers are compared with the bound of the whole marker.",
        ("factor", *(f"{name}: {QUANTITIES[number]}" for _, name, number in columns)),
        tuple(rows),
    )


def nees_table(table: Table) -> Table:
    """Return NEES with a row for each detector and axis."""
    rows = [
        (f"{row[0]}, {axis}", *(cell.split(" / ")[number] if " / " in cell else cell for cell in row[1:]))
        for row in table.rows
        for number, axis in enumerate(("u", "v", "heading"))
    ]
    return Table(table.title, "Mean of error² over the reported variance.", table.header, tuple(rows))


def time_table(table: Table) -> Table:
    """Return the median times."""
    rows = [(row[0], *(cell.partition(" (")[0] for cell in row[1:])) for row in shown_rows(table)]
    note = "Median in ms, one thread, sixteen moving markers of 30 px."
    return Table(table.title, note, table.header, tuple(rows))


def page_tables(tables: Sequence[Table]) -> list[Table]:
    """Return the tables of the page, of those that the benchmark makes."""
    chosen: list[Table] = []
    for table in tables:
        title = table.title
        if title.startswith("Error over") and title.endswith(NOISE):
            chosen += accuracy_tables(narrowed(table))
        elif title == f"Recall, {NOISE}":
            chosen.append(recall_table(narrowed(table)))
        elif title == "One factor at a time":
            chosen.append(factor_table(table))
        elif title.startswith("NEES"):
            chosen.append(nees_table(narrowed(table)))
        elif title == "False positives":
            chosen.append(Table(title, table.note, table.header, tuple(shown_rows(table))))
        elif title == f"Time per frame, {NOISE}":
            chosen.append(time_table(table))
    return chosen


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path, help="output folder of `skyherd bench detectors`")
    options = parser.parse_args()
    result = read_result(options.folder)
    before, rest = DOC.read_text("utf-8").split(BEGIN)
    after = rest.split(END)[1]
    tables = markdown_page(page_tables(make_tables(result)), result.environment)
    DOC.write_text(f"{before}{BEGIN}\n\n{tables}\n{END}{after}", "utf-8")
    for drawn, shown in FIGURES.items():
        shutil.copyfile(options.folder / "figures" / drawn, DOC.parent / shown)
    print(f"written: {DOC}")


if __name__ == "__main__":
    main()
