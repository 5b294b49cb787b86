"""The result on photographs as tables of texts, for the terminal, the page and Markdown alike."""

from skyherd.bench.photographs.result import PhotographsResult
from skyherd.bench.result import Row
from skyherd.bench.tables import NONE, Table, share, short


def make_tables(result: PhotographsResult) -> list[Table]:
    """Make all tables of a result, in the order shown."""
    return [_found(result), _false(result), _times(result)]


def set_tables(result: PhotographsResult) -> list[Table]:
    """A table for each set, with a row for each detector, narrow enough for a terminal."""

    def cells(row: Row) -> tuple[str, ...]:
        return (
            row["detector"],
            str(row["confirmed"]),
            str(row["found"]),
            share(row["recall"]),
            str(row["wrong_ids"]),
            str(row["alone"]),
            short(row["ms_median"]),
            short(row["times_reference"]),
        )

    header = ("detector", "conf.", "found", "recall", "wrong", "alone", "ms", "x opencv")
    return [
        Table(name, "", header, tuple(cells(row) for row in result.rows if row["set"] == name))
        for name in result.sets
        if name not in result.unread()
    ]


def _found(result: PhotographsResult) -> Table:
    rows = []
    for name in result.sets:
        of_set = [result.row(name, detector) for detector in result.detectors]
        known = next((row for row in of_set if row is not None), None)
        confirmed = NONE if known is None else str(known["confirmed"])
        rows.append((name, confirmed, *(_recall(row) for row in of_set)))
    return Table(
        "Markers found",
        "Of the markers that two independent detectors find at the same place: how many a detector finds. "
        "A dash: the detector cannot read this kind of marker.",
        ("set", "confirmed", *result.detectors),
        tuple(rows),
    )


def _recall(row: Row | None) -> str:
    return NONE if row is None else f"{row['found']} ({share(row['recall'])})"


def _false(result: PhotographsResult) -> Table:
    rows = (
        (name, *(_wrong(result.row(name, detector)) for detector in result.detectors)) for name in result.sets
    )
    return Table(
        "Wrong ids, and places that nobody confirms",
        "Confirmed markers that a detector reads as another id / places where only detectors of its family "
        "find anything, of which most show no marker.",
        ("set", *result.detectors),
        tuple(rows),
    )


def _wrong(row: Row | None) -> str:
    return NONE if row is None else f"{row['wrong_ids']} / {row['alone']}"


def _times(result: PhotographsResult) -> Table:
    rows = (
        (name, *(_time(result.row(name, detector)) for detector in result.detectors)) for name in result.sets
    )
    return Table(
        "Time",
        "Median time of an image, ms, and the median over images of its ratio to opencv on the same image, "
        "on one thread.",
        ("set", *result.detectors),
        tuple(rows),
    )


def _time(row: Row | None) -> str:
    if row is None:
        return NONE
    ratio = "" if row["times_reference"] is None else f" ({short(row['times_reference'])}x)"
    return f"{short(row['ms_median'])}{ratio}"
