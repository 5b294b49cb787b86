"""Text tables of the benchmark's result, for the page and for Markdown."""

from collections.abc import Callable, Sequence

from skyherd.bench.detectors.design import CAMERA_SWEEPS, SWEEPS, Sweep
from skyherd.bench.result import Result, Row
from skyherd.bench.table import NONE, Table, share, short

SHOWN_SIDES_PX = (10, 12, 14, 16, 18, 20, 30, 60, 100)
"""Marker sides, px, that have a column; the figures show all of them."""

MIDDLE_NOISE = 5.0
"""Target noise of the NEES table, grey levels; the nearest one is used: that of the base cell."""


def make_tables(result: Result) -> list[Table]:
    """Make all tables for which the result has rows, in the order shown."""
    noises = result.noises()
    middle = min(noises, key=lambda noise: abs(noise - MIDDLE_NOISE), default=MIDDLE_NOISE)
    tables = [
        *(_ratios(result, noise) for noise in noises),
        *(_recalls(result, noise) for noise in noises),
        _factors(
            result,
            SWEEPS,
            "One factor at a time",
            "RMSE of position / of heading over its bound, and recall. Occlusion is held against the bound "
            "of the whole marker, touching squares against that of the marker without them.",
        ),
        _factors(
            result,
            CAMERA_SWEEPS,
            "Lens and processing, one at a time",
            "The same through what a consumer camera does. The bound is that of the raw pixels, with a "
            "Gaussian blur of the same variance: what is done to them afterwards can only lose.",
        ),
        _by_quality(result),
        _nees(result, middle),
        _false_positives(result),
        *(_times(result, noise) for noise in sorted({row["noise"] for row in result.timing})),
    ]
    return [table for table in tables if table.rows]


def _pair(row: Row) -> str:
    if row["ratio_px"] is None:
        return NONE
    return f"{short(row['ratio_px'])} / {short(row['ratio_deg'])}"


def _by_side(result: Result, noise: float, title: str, note: str, cell: Callable[[Row], str]) -> Table:
    """Return rows of detectors and columns of sides."""
    rows = {name: {row["side_px"]: row for row in result.by_side(name, noise)} for name in result.detectors}
    sides = sorted({side for found in rows.values() for side in found if side in SHOWN_SIDES_PX})
    body = tuple(
        (name, *(cell(found[side]) if side in found else NONE for side in sides))
        for name, found in rows.items()
        if found
    )
    return Table(title, note, ("detector", *(f"{side:g} px" for side in sides)), body)


def _ratios(result: Result, noise: float) -> Table:
    return _by_side(
        result,
        noise,
        f"Error over the Cramér–Rao bound, noise {noise:g}",
        "RMSE of position / of heading over its bound, of the markers found; 1 is the bound.",
        _pair,
    )


def _recalls(result: Result, noise: float) -> Table:
    return _by_side(
        result,
        noise,
        f"Recall, noise {noise:g}",
        "Share of the whole markers in view that were found.",
        lambda row: share(row["recall"]),
    )


def _factors(result: Result, sweeps: Sequence[Sweep], title: str, note: str) -> Table:
    """Return rows of conditions and columns of detectors; empty without a cell of the sweeps."""
    names = [name for name in result.detectors if any(row["detector"] == name for row in result.cells)]
    body = []
    base = {row["detector"]: row for row in result.cells if row["sweep"] == "base"}
    if base and any(result.along(sweep, name) for sweep in sweeps for name in names):
        body.append(("none: 30 px, noise 5", *(_with_recall(base.get(name)) for name in names)))
    for sweep in sweeps:
        found = {name: dict(result.along(sweep, name)) for name in names}
        for value in sorted({v for rows in found.values() for v, r in rows.items() if r["sweep"] != "base"}):
            cells = (_with_recall(found[name].get(value)) for name in names)
            body.append((f"{sweep.label}: {value:g}", *cells))
    return Table(title, note, ("factor", *names), tuple(body))


def _with_recall(row: Row | None) -> str:
    return NONE if row is None else f"{_pair(row)}, {share(row['recall'])}"


def _by_quality(result: Result) -> Table:
    """Return rows of conditions in which a detector measured some markers by another way than the fit."""
    body = []
    for row in result.cells:
        photometric, found = row.get("photometric"), row["found"]
        if not photometric or photometric == found:
            continue
        sweep = next((one for one in (*SWEEPS, *CAMERA_SWEEPS) if one.name == row["sweep"]), None)
        where = "" if sweep is None else f"{sweep.label}: {row[sweep.key]:g}, "
        body.append(
            (
                row["detector"],
                f"{where}{row['side_px']:g} px, noise {row['noise']:g}",
                f"{photometric} of {found}",
                f"{_pair(row)}, NEES {short(row['nees'])}",
                f"{short(row['photometric_ratio_px'])} / {short(row['photometric_ratio_deg'])}, "
                f"NEES {short(row['photometric_nees'])}",
            )
        )
    return Table(
        "Photometric measurements alone",
        "Cells in which some markers found were measured robustly or by their edges: how many by a "
        "photometric fit, and RMSE over the bound (position / heading) and NEES of all and of these alone.",
        ("detector", "cell", "photometric", "all", "photometric alone"),
        tuple(body),
    )


def _nees(result: Result, noise: float) -> Table:
    table = _by_side(
        result,
        noise,
        f"NEES of the covariance, noise {noise:g}",
        "Mean of error² over the variance reported, for u / v / heading; 1 is right, more means variances "
        "too small. "
        "Detectors that report no covariance are left out.",
        lambda row: " / ".join(short(row[f"nees_{axis}"]) for axis in ("u", "v", "heading")),
    )
    rows = tuple(row for row in table.rows if any(any(c.isdigit() for c in cell) for cell in row[1:]))
    return Table(table.title, table.note, table.header, rows)


def _false_positives(result: Result) -> Table:
    body = []
    for name in result.detectors:
        rows = [row for row in result.cells if row["detector"] == name]
        empty = result.empty_clutter(name)
        if not rows:
            continue
        total = sum(round(row["false_positives_per_image"] * row["images"]) for row in rows)
        images = sum(row["images"] for row in rows)
        in_clutter = (NONE, NONE)
        if empty is not None:
            in_clutter = (f"{empty['false_positives_per_image']:.3g}", f"{empty['images']}")
        body.append((name, *in_clutter, f"{total}", f"{images}"))
    return Table(
        "False positives",
        "An id that is not in the image, or one more than half a side from its marker.",
        (
            "detector",
            "per image of 150 dark quadrilaterals",
            "such images",
            "in all cells",
            "images of all cells",
        ),
        tuple(body),
    )


def _times(result: Result, noise: float) -> Table:
    """Return rows of detectors and columns of resolutions."""
    rows = {(r["detector"], r["width_px"], r["height_px"]): r for r in result.timing if r["noise"] == noise}
    sizes = sorted({key[1:] for key in rows})
    body = tuple(
        (name, *(_time(rows.get((name, *size))) for size in sizes))
        for name in result.detectors
        if any(key[0] == name for key in rows)
    )
    return Table(
        f"Time per frame, {'clean' if noise == 0 else f'noise {noise:g}'}",
        "Median (99th percentile) in ms, one thread, sixteen markers of 30 px that move; how many times as "
        "fast as opencv on the same frames; recall.",
        ("detector", *(f"{width}x{height}" for width, height in sizes)),
        body,
    )


def _time(row: Row | None) -> str:
    if row is None:
        return NONE
    faster = "" if row["times_faster"] is None else f", {short(row['times_faster'])}x"
    return f"{short(row['ms_median'])} ({short(row['ms_p99'])}){faster}, {share(row['recall'])}"
