"""Text tables of the result on photographs, for the terminal, the page and Markdown."""

from collections.abc import Callable, Mapping
from types import MappingProxyType

from skyherd.bench.photographs.result import PhotographsResult
from skyherd.bench.result import Row
from skyherd.bench.table import NONE, Table, share, short


def make_tables(result: PhotographsResult) -> list[Table]:
    """Make all tables of a result, in the order shown."""
    return [
        _by_set(
            result,
            "Markers found",
            "Of the markers that two independent detectors find at the same place: how many a detector "
            "finds. A dash: the detector cannot read this kind of marker.",
            lambda row: f"{row['found']} ({share(row['recall'])})",
            {
                "half": lambda row: row.get("half") or NONE,
                "confirmed": lambda row: str(row["confirmed"]),
            },
        ),
        _by_set(
            result,
            "Markers measured by a photometric fit",
            "Of the markers found: how many a photometric fit measured. The others are measured robustly or "
            "by their edges, with larger covariances.",
            lambda row: str(row.get("photometric", NONE)),
        ),
        _by_set(
            result,
            "Wrong ids and unconfirmed detections",
            "Confirmed markers that a detector reads as another id / places where only detectors of one "
            "family find anything; most of them show no marker.",
            lambda row: f"{row['wrong_ids']} / {row['alone']}",
        ),
        _by_set(
            result,
            "Time",
            "Median time of an image, ms, and the median over images of its ratio to opencv on the same "
            "image, on one thread.",
            _time,
        ),
    ]


def set_tables(result: PhotographsResult) -> list[Table]:
    """Make a table for each set, with a row for each detector, narrow enough for a terminal."""

    def cells(row: Row) -> tuple[str, ...]:
        return (
            row["detector"],
            str(row["confirmed"]),
            str(row["found"]),
            str(row.get("photometric", NONE)),
            share(row["recall"]),
            str(row["wrong_ids"]),
            str(row["alone"]),
            short(row["ms_median"]),
            short(row["times_reference"]),
        )

    header = ("detector", "conf.", "found", "phot.", "recall", "wrong", "alone", "ms", "x opencv")
    return result.tables_by_set(header, cells)


def _by_set(
    result: PhotographsResult,
    title: str,
    note: str,
    cell: Callable[[Row], str],
    about: Mapping[str, Callable[[Row], str]] = MappingProxyType({}),
) -> Table:
    """Return rows of sets and columns of detectors, preceded by the columns `about` of a set."""
    body = []
    for name in result.sets:
        rows = [result.row(name, detector) for detector in result.detectors]
        known = next((row for row in rows if row is not None), None)
        said = (NONE if known is None else say(known) for say in about.values())
        body.append((name, *said, *(NONE if row is None else cell(row) for row in rows)))
    return Table(title, note, ("set", *about, *result.detectors), tuple(body))


def _time(row: Row) -> str:
    ratio = "" if row["times_reference"] is None else f" ({short(row['times_reference'])}x)"
    return f"{short(row['ms_median'])}{ratio}"
