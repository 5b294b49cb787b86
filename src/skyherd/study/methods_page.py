"""The page of formation controllers, and its tables in Markdown."""

from collections.abc import Sequence
from html import escape
from pathlib import Path

import numpy as np
import pyarrow as pa

from skyherd.files.atomic import write_text
from skyherd.geometry import Array, BoolArray
from skyherd.plots.panels import save_figure
from skyherd.plots.style import drawing_style
from skyherd.report.pages import figure_card, html_page, wide_table
from skyherd.study.figures import MARKDOWN, complaints
from skyherd.study.methods import Method, make_methods
from skyherd.study.methods_plot import draw_methods
from skyherd.study.spec import Study
from skyherd.version import __version__

PAGE = "methods.html"
HEAD = ("method", "formed", "collided", "robots wait (s)", "time to 1 % (s)", "way (m)", "least gap (m)")
CAPTION = (
    "Median of each kind of start, and a line from the least to the greatest. Times count from when robots"
    " may move, and are those of runs that formed the shape. Gaps are between bodies."
)
UNKNOWN = "–"


def write_methods(study: Study, table: pa.Table, folder: Path) -> list[Path]:
    """Write page, Markdown and figure of a study of methods.

    Raises:
        OutputError: a file could not be written.
    """
    methods = make_methods(study, table)
    (folder / "figures").mkdir(parents=True, exist_ok=True)
    with drawing_style():
        figure = save_figure(
            draw_methods(methods), folder / "figures", "methods", "On the same starts", CAPTION
        )
    starts = list(methods[0].outcomes)
    page = html_page(
        "skyherd.study",
        "methods",
        "Methods",
        description=escape(study.spec.description),
        figure=figure_card(figure),
        needs="\n".join(_need(method) for method in methods),
        tables="\n".join(_table(start, methods) for start in starts),
        version=escape(__version__),
    )
    parts = [f"# {study.name}", study.spec.description, *(markdown(start, methods) for start in starts)]
    text = "\n\n".join([*parts, *complaints(table)]) + "\n"
    return [write_text(folder / PAGE, page), write_text(folder / MARKDOWN, text)]


def cells(method: Method, start: str) -> list[str]:
    """One row: the method's name, shares of its runs, and medians with the greatest or least."""
    runs = method.outcomes[start]
    return [
        method.name,
        _count(runs.converged),
        _count(runs.collided),
        _spread(runs.begun_s),
        _spread(runs.times_s),
        _spread(runs.paths_m),
        _spread(runs.gaps_m),
    ]


def markdown(start: str, methods: Sequence[Method]) -> str:
    """One start's table."""
    lines = [list(HEAD), ["---"] * len(HEAD), *(cells(method, start) for method in methods)]
    rows = "\n".join(f"| {' | '.join(line)} |" for line in lines)
    return f"Each robot {start}:\n\n{rows}"


def _count(yes: BoolArray) -> str:
    return f"{int(yes.sum())} of {yes.size}"


def _spread(values: Array) -> str:
    """Median, and the range where there is one."""
    known = values[np.isfinite(values)]
    if not known.size:
        return UNKNOWN
    low, middle, high = (f"{value:.3g}".replace("-", "−") for value in np.quantile(known, (0, 0.5, 1)))
    return middle if low == high else f"{middle} ({low} to {high})"


def _need(method: Method) -> str:
    return f"<dt>{escape(method.name)}</dt><dd>{escape(method.needs)}</dd>"


def _table(start: str, methods: Sequence[Method]) -> str:
    table = wide_table(f"Robots {start}", HEAD, [cells(method, start) for method in methods])
    return f"<section>\n<h2>Each robot {escape(start)}</h2>\n{table}\n</section>"
