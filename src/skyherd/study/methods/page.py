"""Page and Markdown of a study of formation controllers: `methods.html` and `table.md`."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pyarrow as pa

from skyherd.files.atomic import write_text
from skyherd.geometry import Array, BoolArray
from skyherd.plots.panels import Panel, write_panels
from skyherd.report.pages import figure_card, render_page
from skyherd.study.figures import MARKDOWN, complaints
from skyherd.study.methods.outcomes import Method, make_methods
from skyherd.study.methods.plots import draw_methods
from skyherd.study.spec import Study
from skyherd.version import __version__

PAGE = "methods.html"
"""File name of the page, in the study's folder."""

HEAD = ("method", "formed", "collided", "robots wait (s)", "time to 1 % (s)", "way (m)", "least gap (m)")
"""Columns of the tables, in the order of `cells`."""

CAPTION = (
    "Median of each kind of start, and a line from the least to the greatest. Times count from when robots"
    " may move, and are those of runs that formed the shape. Gaps are between bodies."
)
"""Caption of the figure."""

UNKNOWN = "–"
"""What a table has where no run has a value."""


def methods_names(study: Study) -> list[str]:
    """Names of the files that `write_methods` writes into the study's folder."""
    return [PAGE, MARKDOWN, "figures/methods.png", "figures/methods.svg"]


def write_methods(study: Study, table: pa.Table, folder: Path) -> list[Path]:
    """Write page, Markdown and figure of a study of methods into its folder.

    Returns:
        the page and the Markdown file.

    Raises:
        OutputError: a file could not be written.
    """
    methods = make_methods(study, table)
    panel = Panel("methods", "On the same starts", CAPTION, draw_methods)
    figures = write_panels([panel], methods, folder / "figures")
    starts = list(methods[0].outcomes)
    page = render_page(
        "skyherd.study",
        PAGE,
        title="Methods",
        description=study.spec.description,
        figures=[figure_card(figure) for figure in figures],
        methods=methods,
        head=HEAD,
        tables=[{"start": start, "rows": [cells(method, start) for method in methods]} for start in starts],
        version=__version__,
    )
    parts = [f"# {study.name}", study.spec.description, *(markdown(start, methods) for start in starts)]
    text = "\n\n".join([*parts, *complaints(table)]) + "\n"
    return [write_text(folder / PAGE, page), write_text(folder / MARKDOWN, text)]


def cells(method: Method, start: str) -> list[str]:
    """A method's row of the table of one start, in the order of `HEAD`.

    Shares are written as `3 of 4`, times and lengths as the median and the range, such as `7 (6 to 8)`.
    """
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
    """The table of one start in Markdown, a row a method."""
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
