"""The invariance report's page, and its table in Markdown."""

from collections.abc import Sequence
from html import escape
from pathlib import Path

import numpy as np
import pyarrow as pa

from skyherd.files.atomic import write_text
from skyherd.report.pages import figure_card, html_page, tile, wide_table
from skyherd.study.figures import MARKDOWN, complaints
from skyherd.study.invariance import IDEAL, RENDERED, Sweep, make_sweeps
from skyherd.study.invariance_plots import draw_sweeps
from skyherd.study.plan import make_plan
from skyherd.study.spec import Study
from skyherd.study.store import ERROR
from skyherd.version import __version__

PAGE = "invariance.html"
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
Cells = list[str]

ROUNDING = 1e-9
"""Smaller numbers are those that float64 leaves."""


def write_invariance(study: Study, table: pa.Table, folder: Path) -> list[Path]:
    """Write page, Markdown and figures of a study of cameras.

    Raises:
        InputError: the reference's run failed.
        OutputError: a file could not be written.
    """
    sweeps = make_sweeps(make_plan(study), table)
    cards = {figure.title.lower(): figure_card(figure) for figure in draw_sweeps(sweeps, folder / "figures")}
    failed = table.num_rows - table[ERROR].null_count
    page = html_page(
        "skyherd.study",
        "invariance",
        "Invariance",
        description=escape(study.spec.description),
        tiles="\n".join(tile(value, label) for value, label in _tiles(sweeps, table.num_rows, failed)),
        inside=_section(sweeps, cards, inside=True),
        outside=_section(sweeps, cards, inside=False),
        version=escape(__version__),
    )
    parts = [f"# {study.name}", study.spec.description]
    for title, inside in (("Inside Property 1's class:", True), ("Outside it:", False)):
        parts += [title, markdown([sweep for sweep in sweeps if sweep.inside == inside])]
    text = "\n\n".join([*parts, *complaints(table)]) + "\n"
    return [write_text(folder / PAGE, page), write_text(folder / MARKDOWN, text)]


def markdown(sweeps: Sequence[Sweep]) -> str:
    """The table: a row a sweep, the worst rendered run of it."""
    rows = [list(HEAD), ["---"] * len(HEAD), *map(cells, sweeps)]
    return "\n".join(f"| {' | '.join(row)} |" for row in rows)


def cells(sweep: Sweep) -> Cells:
    """A sweep in words: goals and paths in marker sides."""
    seen, ours = (sweep.worst(RENDERED, rectified=rectified) for rectified in (False, True))
    predicted, noise = sweep.predicted(), np.array(sweep.floors()).T[1].max()
    numbers = (
        predicted.goals, seen.goals, ours.goals, noise, seen.paths, ours.paths, predicted.shape, seen.shape,
        ours.shape,
    )  # fmt: skip
    return [sweep.name, _range(sweep), *map(_short, numbers)]


def _range(sweep: Sweep) -> str:
    values = [point.value for point in sweep.points]
    numbers = [value for value in values if not isinstance(value, str)]
    if len(numbers) < len(values):
        return f"{sweep.label}: {len(values)}"
    return f"{sweep.label}: {min(numbers):g} to {max(numbers):g}"


def _short(value: float) -> str:
    if np.isnan(value):
        return "–"
    if value < ROUNDING:
        return "0"
    return f"{value:.1e}".replace("e-0", "e-") if value < 1e-3 else f"{value:.2g}"


def _tiles(sweeps: Sequence[Sweep], runs: int, failed: int) -> list[tuple[str, str]]:
    def most(inside: bool, rectified: bool, field: str, perception: str = RENDERED) -> str:
        values = [
            getattr(sweep.worst(perception, rectified=rectified), field)
            for sweep in sweeps
            if sweep.inside == inside
        ]
        return _short(float(np.nanmax([np.nan, *values]))) if np.isfinite(values).any() else "–"

    exact = most(True, False, "paths", IDEAL)
    exact = f"under {ROUNDING:.0e}" if exact == "0" else exact
    return [
        (str(runs), f"runs, {failed} failed" if failed else "runs, none failed"),
        (exact, "worst path inside the class, exact images, marker sides"),
        (most(True, False, "shape"), "worst shape error inside the class, rendered"),
        (most(False, False, "shape"), "worst shape error outside it, as seen"),
        (most(False, True, "shape"), "worst shape error outside it, rectified"),
    ]


def _section(sweeps: Sequence[Sweep], cards: dict[str, str], *, inside: bool) -> str:
    """The table of some sweeps, and their figures."""
    mine = [sweep for sweep in sweeps if sweep.inside == inside]
    if not mine:
        return '<p class="hint">No sweep of this study.</p>'
    table = wide_table(
        f"Sweeps {'in' if inside else 'out'}side the class", HEAD, [cells(sweep) for sweep in mine]
    )
    figures = "\n".join(cards[sweep.name.lower()] for sweep in mine)
    return f'{table}\n<div class="figures">\n{figures}\n</div>'
