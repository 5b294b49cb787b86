"""Text tables of the result on boards, for the terminal, the page and Markdown."""

from collections.abc import Callable
from dataclasses import dataclass

from skyherd.bench.result import Row
from skyherd.bench.set_result import SetResult
from skyherd.bench.table import NONE, Table, share, short


@dataclass(frozen=True)
class Comparison:
    """A table that compares the detectors in each set: title, note, and a column of the result."""

    title: str
    note: str
    cell: Callable[[Row], str]

    def table(self, result: SetResult) -> Table:
        """Return rows of detectors and columns of sets, without detectors that have no number."""
        sets = [name for name in result.sets if name not in result.unread()]
        body = []
        for detector in result.detectors:
            rows = [result.row(name, detector) for name in sets]
            cells = [NONE if row is None else self.cell(row) for row in rows]
            if any(any(letter.isdigit() for letter in text) for text in cells):
                body.append((detector, *cells))
        return Table(self.title, self.note, ("detector", *sets), tuple(body))


def make_tables(result: SetResult) -> list[Table]:
    """Make all tables of a result, in the order shown."""
    return [*(comparison.table(result) for comparison in COMPARISONS), _floors(result)]


def set_tables(result: SetResult) -> list[Table]:
    """Make a table for each set, with a row for each detector, narrow enough for a terminal."""

    def cells(row: Row) -> tuple[str, ...]:
        return (
            row["detector"],
            share(row["recall"]),
            fine(row["center_px"]),
            fine(row["corner_px"]),
            fine(row["heading_deg"]),
            short(row["nees_center"]),
            short(row["times_reference"]),
        )

    header = ("detector", "recall", "centre px", "corner px", "heading deg", "NEES", "x opencv")
    return result.tables_by_set(header, cells)


def fine(value: float | None) -> str:
    """Format a small number with three decimals; `–` for None."""
    return NONE if value is None else f"{value:.3f}"


def _nees(row: Row) -> str:
    if row["nees_center"] is None:
        return NONE
    plain, beside = (
        " / ".join(short(row[f"nees_{quantity}{end}"]) for quantity in ("center", "heading"))
        for end in ("", "_with_floor")
    )
    return f"{plain} ({beside})"


def _errors(row: Row, kind: str = "") -> str:
    """Return errors of centre, corners and heading, of a kind such as `_common`: px, px and degrees."""
    keys = (f"center{kind}_px", f"corner{kind}_px", f"heading{kind}_deg")
    return " / ".join(fine(row[key]) for key in keys)


def _floors(result: SetResult) -> Table:
    body = []
    for name in result.sets:
        row = next((row for row in result.rows if row["set"] == name), None)
        if row is not None:
            floors = (fine(row[key]) for key in ("center_floor_px", "corner_floor_px", "heading_floor_deg"))
            body.append((name, row["board"], str(row["images"]), str(row["degree"]), *floors))
    return Table(
        "Sets and floors",
        "Degree of the polynomials that model the lens, and the floor of the medians above.",
        ("set", "board", "images", "degree", "centre px", "corner px", "heading deg"),
        tuple(body),
    )


COMPARISONS = (
    Comparison(
        "Accuracy, leaving one out",
        "Median distance of centre / of corners from their prediction by all other markers, px / median "
        "error of the heading, degrees; without the errors of that prediction.",
        _errors,
    ),
    Comparison(
        "Beyond the floor",
        "The same with the floor subtracted in quadrature. The floor is the error that two independent "
        "detectors share: it comes from board, lens and image.",
        lambda row: _errors(row, "_beyond_floor"),
    ),
    Comparison(
        "On the markers that all find",
        "Median error of centre / corners / heading, of the markers found by all detectors that find "
        "four of five.",
        lambda row: _errors(row, "_common"),
    ),
    Comparison(
        "Large errors",
        "95th percentile of the errors of centre / corners / heading, and the number of markers that lie "
        "far from where they must be.",
        lambda row: f"{_errors(row, '_p95')} / {row['outliers']}",
    ),
    Comparison(
        "Covariance compared with the errors",
        "Mean of error² over the variance reported, of the centre / of the heading; in brackets with the "
        "floor's variance added to it. 1 is right, more means variances that are too small.",
        _nees,
    ),
    Comparison(
        "Recall and time",
        "Share of the markers that two independent detectors confirm; median time of an image, ms; its "
        "median ratio to opencv.",
        lambda row: f"{share(row['recall'])}, {short(row['ms_median'])}, {short(row['times_reference'])}x",
    ),
)
"""Tables that compare detectors, in the order shown."""
