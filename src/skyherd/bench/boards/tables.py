"""The result on boards as tables of texts, for the terminal, the page and Markdown alike."""

from collections.abc import Callable

from skyherd.bench.result import Row
from skyherd.bench.set_result import SetResult
from skyherd.bench.tables import NONE, Table, share, short


def make_tables(result: SetResult) -> list[Table]:
    """Make all tables of a result, in the order shown."""
    return [
        _table(
            result,
            "Accuracy, leaving one out",
            "Median distance of centre / of corners from where all other markers put them, px / median error "
            "of the heading, degrees; without the errors of that prediction.",
            lambda row: " / ".join(fine(row[key]) for key in ("center_px", "corner_px", "heading_deg")),
        ),
        _table(
            result,
            "Beyond the floor",
            "The same with the floor taken off in quadrature: what two independent detectors have in common, "
            "which is board, lens and image rather than detector.",
            lambda row: " / ".join(
                fine(row[key])
                for key in ("center_beyond_floor_px", "corner_beyond_floor_px", "heading_beyond_floor_deg")
            ),
        ),
        _table(
            result,
            "On the markers that all find",
            "Median error of centre / corners / heading, of the markers found by all detectors that find "
            "four of five.",
            lambda row: " / ".join(
                fine(row[key]) for key in ("center_common_px", "corner_common_px", "heading_common_deg")
            ),
        ),
        _table(
            result,
            "Large errors",
            "95th percentile of the errors of centre / corners / heading, and the number of markers that lie "
            "far from where they must be.",
            lambda row: " / ".join(
                [
                    *(fine(row[key]) for key in ("center_p95_px", "corner_p95_px", "heading_p95_deg")),
                    str(row["outliers"]),
                ]
            ),
        ),
        _table(
            result,
            "Covariance compared with the errors",
            "Mean of error² over the variance reported, of the centre / of the heading; in brackets with the "
            "floor's variance added to it. 1 is right, more means variances that are too small.",
            _nees,
        ),
        _table(
            result,
            "Recall and time",
            "Share of the markers that two independent detectors confirm; median time of an image, ms; its "
            "median ratio to opencv.",
            lambda row: (
                f"{share(row['recall'])}, {short(row['ms_median'])}, {short(row['times_reference'])}x"
            ),
        ),
        _floors(result),
    ]


def set_tables(result: SetResult) -> list[Table]:
    """A table for each set, with a row for each detector, narrow enough for a terminal."""

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
    return [
        Table(name, "", header, tuple(cells(row) for row in result.rows if row["set"] == name))
        for name in result.sets
        if name not in result.unread()
    ]


def fine(value: float | None) -> str:
    """A small number with three decimals; `–` for None."""
    return NONE if value is None else f"{value:.3f}"


def _nees(row: Row) -> str:
    if row["nees_center"] is None:
        return NONE
    plain, beside = (
        " / ".join(short(row[f"nees_{quantity}{end}"]) for quantity in ("center", "heading"))
        for end in ("", "_with_floor")
    )
    return f"{plain} ({beside})"


def _table(result: SetResult, title: str, note: str, cell: Callable[[Row], str]) -> Table:
    """Rows of detectors, columns of sets."""
    sets = [name for name in result.sets if name not in result.unread()]
    body = []
    for detector in result.detectors:
        rows = [result.row(name, detector) for name in sets]
        cells = [NONE if row is None else cell(row) for row in rows]
        if any(any(letter.isdigit() for letter in text) for text in cells):
            body.append((detector, *cells))
    return Table(title, note, ("detector", *sets), tuple(body))


def _floors(result: SetResult) -> Table:
    body = []
    for name in result.sets:
        row = next((row for row in result.rows if row["set"] == name), None)
        if row is not None:
            floors = (
                fine(row[f"{key}"]) for key in ("center_floor_px", "corner_floor_px", "heading_floor_deg")
            )
            body.append((name, row["board"], str(row["images"]), str(row["degree"]), *floors))
    return Table(
        "Sets and floors",
        "Degree of the polynomials that stand for the lens, and the floor of the medians above.",
        ("set", "board", "images", "degree", "centre px", "corner px", "heading deg"),
        tuple(body),
    )
