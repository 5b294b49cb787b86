"""The page of formation controllers: one HTML file that needs no other, and its tables in Markdown."""

from collections.abc import Sequence
from html import escape
from importlib.resources import files
from pathlib import Path
from string import Template

import numpy as np
import pyarrow as pa

from skyherd import __version__
from skyherd.figure_canvas import drawing_style
from skyherd.figures import save_figure
from skyherd.files import write_text
from skyherd.geometry import Array, BoolArray
from skyherd.report import figure_card, page_style
from skyherd.study.figures import MARKDOWN, complaints
from skyherd.study.methods import Method, make_methods
from skyherd.study.methods_plot import draw_methods
from skyherd.study.spec import Study

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
    page = Template(files("skyherd.study").joinpath("methods.html").read_text("utf-8")).substitute(
        style=page_style(),
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
    head = "".join(f'<th scope="col">{escape(word)}</th>' for word in HEAD)
    body = "\n".join(
        f'<tr><th scope="row">{escape(row[0])}</th>'
        + "".join(f"<td>{escape(cell)}</td>" for cell in row[1:])
        + "</tr>"
        for row in (cells(method, start) for method in methods)
    )
    return f"""<section>
<h2>Each robot {escape(start)}</h2>
<div class="scroll" tabindex="0" role="region" aria-label="Robots {escape(start)}">
<table><thead><tr>{head}</tr></thead>
<tbody>
{body}
</tbody></table>
</div>
</section>"""
