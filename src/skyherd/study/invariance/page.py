"""Page and Markdown of a study of cameras: `invariance.html` and `table.md`."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pyarrow as pa

from skyherd.files.atomic import write_text
from skyherd.report.pages import Tile, figure_card, render_page
from skyherd.study.figures import MARKDOWN, complaints
from skyherd.study.invariance.measures import IDEAL, RENDERED, Sweep, make_sweeps
from skyherd.study.invariance.plots import draw_sweeps, figure_name
from skyherd.study.plan import make_plan
from skyherd.study.spec import Study
from skyherd.study.store import ERROR
from skyherd.version import __version__

PAGE = "invariance.html"
"""File name of the page, in the study's folder."""

HEAD = (
    "sweep",
    "over",
    "goals: predicted",
    "goals: as seen",
    "goals: rectified",
    "paths: noise alone",
    "paths: as seen",
    "paths: rectified",
    "shape: predicted",
    "shape: as seen",
    "shape: rectified",
)
"""Columns of the table, in the order of `cells`. Goals and paths are in marker sides."""

ROUNDING = 1e-9
"""Measures below this, in marker sides, are written as 0. Derived: float64 has a relative error of 1e-16 per
operation; some hundred steps over positions of some ten sides add up to less."""

SCIENTIFIC = 1e-3
"""Measures below this are written with an exponent, since `1.2e-4` is more legible than `0.00012`."""

MISSING = "–"
"""Text of a cell without a measurement."""


def invariance_names(study: Study) -> list[str]:
    """Return the possible outputs of `write_invariance` in the study's folder."""
    figures = [figure_name(sweep.name) for sweep in study.spec.all_sweeps]
    return [PAGE, MARKDOWN, *(f"figures/{name}{kind}" for name in figures for kind in (".png", ".svg"))]


def write_invariance(study: Study, table: pa.Table, folder: Path) -> list[Path]:
    """Write page, Markdown and figures of a study of cameras into its folder.

    Returns:
        the page and the Markdown file.

    Raises:
        InputError: the reference run failed.
        OutputError: a file could not be written.
    """
    sweeps = make_sweeps(make_plan(study), table)
    figures = draw_sweeps(sweeps, folder / "figures")
    shown = [
        {"inside": sweep.inside, "cells": cells(sweep), "figure": figure_card(figure)}
        for sweep, figure in zip(sweeps, figures, strict=True)
    ]
    page = render_page(
        "skyherd.study",
        PAGE,
        title="Invariance",
        description=study.spec.description,
        tiles=_tiles(sweeps, table.num_rows, failed=table.num_rows - table[ERROR].null_count),
        head=HEAD,
        inside=[sweep for sweep in shown if sweep["inside"]],
        outside=[sweep for sweep in shown if not sweep["inside"]],
        version=__version__,
    )
    parts = [f"# {study.name}", study.spec.description]
    for title, inside in (("Inside Property 1's class:", True), ("Outside it:", False)):
        parts += [title, markdown([sweep for sweep in sweeps if sweep.inside == inside])]
    text = "\n\n".join([*parts, *complaints(table)]) + "\n"
    return [write_text(folder / PAGE, page), write_text(folder / MARKDOWN, text)]


def markdown(sweeps: Sequence[Sweep]) -> str:
    """Return the table in Markdown: one row per sweep, with its worst rendered run."""
    rows = [list(HEAD), ["---"] * len(HEAD), *map(cells, sweeps)]
    return "\n".join(f"| {' | '.join(row)} |" for row in rows)


def cells(sweep: Sweep) -> list[str]:
    """Return a sweep's row of the table, in the order of `HEAD`, of its worst rendered run, as texts."""
    seen, rectified = (sweep.worst(RENDERED, rectified=rectified) for rectified in (False, True))
    predicted, noise_paths = sweep.predicted(), max(floor.paths for floor in sweep.floors())
    numbers = (
        *(predicted.goals, seen.goals, rectified.goals),
        *(noise_paths, seen.paths, rectified.paths),
        *(predicted.shape, seen.shape, rectified.shape),
    )
    return [sweep.name, _range(sweep), *map(_short, numbers)]


def _range(sweep: Sweep) -> str:
    """Return the parameter and the span of its values, or their number if they are not numeric."""
    values = [point.value for point in sweep.points]
    numbers = [value for value in values if not isinstance(value, str)]
    if len(numbers) < len(values):
        return f"{sweep.label}: {len(values)}"
    return f"{sweep.label}: {min(numbers):g} to {max(numbers):g}"


def _short(value: float) -> str:
    if np.isnan(value):
        return MISSING
    if value < ROUNDING:
        return "0"
    return f"{value:.1e}".replace("e-0", "e-") if value < SCIENTIFIC else f"{value:.2g}"


def _tiles(sweeps: Sequence[Sweep], runs: int, *, failed: int) -> list[Tile]:
    """Return the study in a few numbers: the worst of each class, as seen and rectified."""

    def worst(field: str, perception: str = RENDERED, *, inside: bool, rectified: bool) -> str:
        values = [
            getattr(sweep.worst(perception, rectified=rectified), field)
            for sweep in sweeps
            if sweep.inside == inside
        ]
        return _short(float(np.nanmax([np.nan, *values]))) if np.isfinite(values).any() else MISSING

    exact = worst("paths", IDEAL, inside=True, rectified=False)
    return [
        Tile(str(runs), f"runs, {failed} failed" if failed else "runs, none failed"),
        Tile(
            f"under {ROUNDING:.0e}" if exact == "0" else exact,
            "worst path inside the class, exact images, marker sides",
        ),
        Tile(worst("shape", inside=True, rectified=False), "worst shape error inside the class, rendered"),
        Tile(worst("shape", inside=False, rectified=False), "worst shape error outside it, as seen"),
        Tile(worst("shape", inside=False, rectified=True), "worst shape error outside it, rectified"),
    ]
