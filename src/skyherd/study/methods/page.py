"""Page and Markdown of a study of formation controllers: `methods.html` and `table.md`."""

import re
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from skyherd.datasets import get_value
from skyherd.files.atomic import write_text
from skyherd.geometry import Array, BoolArray
from skyherd.plots.panels import Panel, write_panels
from skyherd.report.pages import figure_card, render_page
from skyherd.study.figures import MARKDOWN, complaints
from skyherd.study.methods.outcomes import Method, make_methods
from skyherd.study.methods.paths import draw_paths
from skyherd.study.methods.plots import draw_methods, median
from skyherd.study.parts import TaskModel
from skyherd.study.plan import study_source
from skyherd.study.spec import Study
from skyherd.version import __version__

PAGE = "methods.html"
"""File name of the page, in the study's folder."""

HEAD = (
    "method",
    "formed",
    "affine image formed",
    "collided",
    "robots wait (s)",
    "time to 1 % (s)",
    "time to 1 % of an affine image (s)",
    "path over the shortest",
    "way (m)",
    "least gap (m)",
    "shape error at the end",
    "affine error at the end",
    "messages per robot and second",
    "numbers per robot and second",
)
"""Columns of the tables, in the order of `cells`."""

OVERVIEW = "of the runs formed the shape, and their median time, including the wait for units."
"""Content of the first table's cells, after the number of runs."""

CAPTION = (
    "One row per method, one column per task. Times, paths and numbers are medians. Times count from when"
    " robots may move, and are those of runs that formed the shape. The shortest path is the least sum of"
    " straight lines from the start into the shape, at any position, rotation, size and roles. A method that"
    " stops at an affine image may need less."
)
"""Caption of the figure."""

PATHS_CAPTION = "The first start. Dots: initial positions; circles: bodies at the end."
"""Caption of the figures of paths."""

UNKNOWN = "–"
"""Text of a cell where no run has a value."""


def methods_names(study: Study) -> list[str]:
    """Return the possible outputs of `write_methods` in the study's folder."""
    figures = ["methods", *(_figure_name(task.name) for task in study.spec.tasks)]
    return [PAGE, MARKDOWN, *(f"figures/{name}{kind}" for name in figures for kind in (".png", ".svg"))]


def write_methods(study: Study, table: pa.Table, folder: Path) -> list[Path]:
    """Write page, Markdown and figures of a study of methods into its folder.

    Returns:
        the page and the Markdown file.

    Raises:
        OutputError: a file could not be written.
    """
    methods, tasks = make_methods(study, table), study.spec.tasks
    drawn = write_panels(_panels(study), methods, folder / "figures")
    figures = {figure.name: figure_card(figure) for figure in drawn}
    page = render_page(
        "skyherd.study",
        PAGE,
        title="Methods",
        description=study.spec.description,
        tasks_version=study.spec.tasks_version,
        overview_head=["method", *(task.name for task in tasks)],
        overview=[[method.name, *(glance(method, task.name) for task in tasks)] for method in methods],
        overview_caption=OVERVIEW,
        figures=[figures["methods"]],
        methods=methods,
        head=HEAD,
        tables=[
            {
                "name": task.name,
                "about": task.about,
                "rows": [cells(method, task.name) for method in methods],
                "figures": [figures[name]] if (name := _figure_name(task.name)) in figures else [],
            }
            for task in tasks
        ],
        version=__version__,
    )
    head = [f"# {study.name}", study.spec.description, f"Tasks, version {study.spec.tasks_version}."]
    parts = [*head, *(markdown(task, methods) for task in tasks)]
    text = "\n\n".join([*parts, *complaints(table)]) + "\n"
    return [write_text(folder / PAGE, page), write_text(folder / MARKDOWN, text)]


def _panels(study: Study) -> list[Panel[list[Method]]]:
    """Return the panels: all methods on all tasks, and the paths of each task."""
    return [
        Panel("methods", "On the same starts", CAPTION, draw_methods),
        *(
            Panel(
                _figure_name(task.name),
                f"Paths: {task.name}",
                PATHS_CAPTION,
                partial(draw_paths, task.name, bodies=_bodies(study, task)),
            )
            for task in study.spec.tasks
        ),
    ]


def glance(method: Method, task: str) -> str:
    """Return the number of runs that formed the shape, and their median time, as `3 of 4, 12 s`."""
    runs = method.outcomes[task]
    time_s = median(runs.begun_s + runs.times_s)
    return _count(runs.converged) + (f", {time_s:.3g} s" if np.isfinite(time_s) else "")


def cells(method: Method, task: str) -> list[str]:
    """Return a method's row of the table of one task, in the order of `HEAD`.

    Shares are written as `3 of 4`, times and lengths as the median and the range, such as `7 (6 to 8)`.
    """
    runs = method.outcomes[task]
    return [
        method.name,
        _count(runs.converged),
        _count(runs.affine),
        _count(runs.collided),
        _spread(runs.begun_s),
        _spread(runs.times_s),
        _spread(runs.affine_times_s),
        _spread(runs.detours),
        _spread(runs.paths_m),
        _spread(runs.gaps_m),
        _spread(runs.errors),
        _spread(runs.affine_errors),
        _spread(runs.messages_ps),
        _spread(runs.numbers_ps),
    ]


def markdown(task: TaskModel, methods: Sequence[Method]) -> str:
    """Return the table of one task in Markdown, a row per method."""
    lines = [list(HEAD), ["---"] * len(HEAD), *(cells(method, task.name) for method in methods)]
    rows = "\n".join(f"| {' | '.join(line)} |" for line in lines)
    return f"## {task.name}\n\n{task.about}\n\n{rows}"


def _figure_name(task: str) -> str:
    return "paths-" + re.sub(r"\W+", "-", task)


def _bodies(study: Study, task: TaskModel) -> dict[str, Any]:
    """Return the radius of the robots' bodies, and the obstacles, for `draw_paths`."""
    tree = study_source(study).tree

    def value(key: str, default: Any) -> Any:
        if key in task.set:
            return task.set[key]
        try:
            return get_value(tree, key)
        except (KeyError, IndexError, TypeError, ValueError):
            return default

    side_m = value("marker.side_m", 0.0)
    return {
        "radius_m": side_m * value("robots.body_radius_sides", 0.0),
        "obstacles": [
            (*one["position_m"], side_m * one.get("radius_sides", 1.0)) for one in value("obstacles", [])
        ],
    }


def _count(yes: BoolArray) -> str:
    return f"{int(yes.sum())} of {yes.size}"


def _spread(values: Array) -> str:
    """Return the median, and the range if there is one."""
    known = values[np.isfinite(values)]
    if not known.size:
        return UNKNOWN
    low, middle, high = (f"{value:.3g}".replace("-", "−") for value in np.quantile(known, (0, 0.5, 1)))
    return middle if low == high else f"{middle} ({low} to {high})"
