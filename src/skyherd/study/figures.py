"""A study's table as Markdown, and figures defined in the study's file."""

from collections import Counter
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import NullFormatter, ScalarFormatter

from skyherd.drawing.palette import UNIT_COLORS
from skyherd.files.atomic import write_text, write_whole
from skyherd.plots.style import DPI, drawing_style, label_log_axis, new_figure, plain
from skyherd.study.spec import SUMMARY_FIELDS, FigureModel, Study, StudySpec
from skyherd.study.store import ERROR
from skyherd.study.table import SWEEP, Row, good_rows

MARKDOWN = "table.md"
"""File name of the table in Markdown, in the study's folder."""

MARKS = "osD^vPX<"
"""Matplotlib markers of the lines of a figure."""

MAX_ERRORS = 5
"""Maximum number of different errors that are listed; the others are counted."""

MAX_TICKS = 9
"""Maximum number of values of x with a tick each; more would overlap."""

HEIGHT_IN = 4.2
"""Height of a figure, inches."""


def figure_names(study: Study) -> list[str]:
    """Return the possible outputs of `write_figure_pages` in the study's folder."""
    return [MARKDOWN, *(f"{model.name}.png" for model in study.spec.figures)]


def write_figure_pages(study: Study, table: pa.Table, folder: Path) -> list[Path]:
    """Write `table.md`, and a PNG for each figure of the study that has data.

    Returns:
        the figures and then the Markdown file.

    Raises:
        OutputError: a file could not be written.
    """
    rows = good_rows(table)
    with drawing_style():
        figures = {model.name: draw_figure(model, rows, study.spec) for model in study.spec.figures}
        drawn = [_save(figure, folder / f"{name}.png") for name, figure in figures.items() if figure]
    text = "\n\n".join(
        [
            f"# {study.name}",
            study.spec.description,
            markdown_table(study.spec, table),
            *(f"![{path.stem}]({path.name})" for path in drawn),
            *complaints(table),
        ]
    )
    return [*drawn, write_text(folder / MARKDOWN, text + "\n")]


def _save(figure: Figure, path: Path) -> Path:
    return write_whole(path, lambda part: figure.savefig(part, format="png", dpi=DPI))


def draw_figure(model: FigureModel, rows: Sequence[Row], spec: StudySpec) -> Figure | None:
    """Draw a figure of a study: median and range of the runs for each line and x.

    The title names both where a point has several runs. Where x is drawn at random, each run is a separate
    dot.

    Args:
        model: the figure's definition in the study's file.
        rows: rows of the table of runs without an error.
        spec: the study.

    Returns:
        None if no run has both values.
    """
    shown = [
        row
        for row in rows
        if model.sweep in (None, row.get(SWEEP)) and row[model.x] is not None and _is_number(row[model.y])
    ]
    if not shown:
        return None
    figure = new_figure(HEIGHT_IN)
    axes = figure.subplots()
    places = _places(axes, [row[model.x] for row in shown], log=model.x_log)
    lines = _distinct(row[model.lines] for row in shown) if model.lines else [None]
    for index, line in enumerate(lines):
        mine = [row for row in shown if model.lines is None or row[model.lines] == line]
        points = [(places[_hashable(row[model.x])], float(row[model.y])) for row in mine]
        style = {"color": UNIT_COLORS[index % len(UNIT_COLORS)], "marker": MARKS[index % len(MARKS)]}
        _draw_points(axes, points, dots=model.x in spec.drawn, label=_text(line), **style)
    runs = Counter((str(row[model.x]), str(row[model.lines]) if model.lines else "") for row in shown)
    spread = ": median and range" if max(runs.values()) > 1 and model.x not in spec.drawn else ""
    axes.set_title(plain(f"{model.title}{spread}"))
    axes.set_xlabel(plain(model.x_label or model.x))
    axes.set_ylabel(plain(model.y_label or field_label(model.y)))
    if model.y_log and any(row[model.y] > 0 for row in shown):
        axes.set_yscale("log", nonpositive="mask")
        label_log_axis(axes.yaxis)
    if model.lines:
        figure.legend(title=plain(model.lines_label or model.lines), loc="outside right upper")
    return figure


def _draw_points(axes: Axes, points: list[tuple[float, float]], *, dots: bool, **style: Any) -> None:
    if dots:
        axes.plot(*np.array(points).T, linestyle="", markersize=4, alpha=0.8, **style)
        return
    xs = sorted({x for x, _ in points})
    groups = [np.array([y for at, y in points if at == x]) for x in xs]
    middle = np.array([np.median(group) for group in groups])
    reach = [
        middle - [group.min() for group in groups],
        np.array([group.max() for group in groups]) - middle,
    ]
    several = any(group.size > 1 for group in groups)
    line = "-" if len(xs) > 1 else ""
    axes.errorbar(
        xs,
        middle,
        yerr=reach if several else None,
        linestyle=line,
        capsize=3,
        elinewidth=0.9,
        markersize=5,
        **style,
    )


def _places(axes: Axes, values: Sequence[Any], *, log: bool) -> dict[Any, float]:
    """Return axis positions of the values of x: numbers at their value, others side by side, with names."""
    distinct = _distinct(values)
    if all(_is_number(value) for value in distinct):
        if log and distinct[0] > 0:
            axes.set_xscale("log")
        if len(distinct) <= MAX_TICKS:
            axes.set_xticks(distinct, [_text(value) for value in distinct])
            axes.xaxis.set_minor_formatter(NullFormatter())
        elif not log:
            axes.xaxis.set_major_formatter(ScalarFormatter())
        return {value: float(value) for value in distinct}
    axes.set_xticks(range(len(distinct)), [_text(value) for value in distinct])
    return {_hashable(value): float(place) for place, value in enumerate(distinct)}


def markdown_table(spec: StudySpec, table: pa.Table) -> str:
    """Return the table in Markdown: medians and ranges for each combination of parameters.

    Runs that differ only in the seed or in randomly drawn parameters share a row.
    """
    keys = [key for key in spec.parameters if key != "seed" and key not in spec.drawn]
    keys = [*([SWEEP] if spec.sweeps else []), *keys]
    fields = [name for name in spec.fields if name not in keys]
    groups: dict[Any, list[Row]] = {}
    for row in table.select(list(dict.fromkeys([*keys, *fields, ERROR]))).to_pylist():
        groups.setdefault(tuple(_hashable(row[key]) for key in keys), []).append(row)
    head = [
        *(key if key == SWEEP else f"`{key}`" for key in keys),
        "runs",
        "failed",
        *map(field_label, fields),
    ]
    lines = [head, ["---"] * len(head)]
    for rows in groups.values():
        good = [row for row in rows if row[ERROR] is None]
        lines.append(
            [
                *(_text(rows[0][key]) for key in keys),
                str(len(rows)),
                str(len(rows) - len(good)),
                *(_spread([row[name] for row in good]) for name in fields),
            ]
        )
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def field_label(name: str) -> str:
    """Return the label of a field of the summary, with its unit in brackets."""
    field = SUMMARY_FIELDS[name]
    unit = "rad" if field.kind == "angle" else field.unit
    return f"{field.label} ({unit})" if unit else field.label


def _spread(values: list[Any]) -> str:
    """Return the values of one cell: median and range of numbers, the count of true values, or all texts."""
    known = [value for value in values if value is not None]
    if not known:
        return "–"
    if all(isinstance(value, bool) for value in known):
        return f"{sum(known)} of {len(known)}"
    if not all(_is_number(value) for value in known):
        return ", ".join(map(_text, _distinct(known)))
    low, middle, high = (_text(float(value)) for value in np.quantile(known, (0, 0.5, 1)))
    return middle if low == high else f"{middle} ({low} to {high})"


def complaints(table: pa.Table) -> list[str]:
    """Return the errors of failed runs as a Markdown list, most frequent first; empty if none failed."""
    errors = Counter(error for error in table[ERROR].to_pylist() if error is not None)
    lines = [f"- {count} failed: {error}" for error, count in errors.most_common(MAX_ERRORS)]
    more = len(errors) - len(lines)
    return (
        ["\n".join([*lines, *([f"- and {more} other errors, in the column `error`"] if more > 0 else [])])]
        if lines
        else []
    )


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and bool(np.isfinite(value))


def _distinct(values: Iterable[Any]) -> list[Any]:
    """Return each value once: numbers ascending, others in their order."""
    distinct = list({_hashable(value): value for value in values}.values())
    return sorted(distinct) if all(_is_number(value) for value in distinct) else distinct


def _hashable(value: Any) -> Any:
    return str(value) if isinstance(value, list | dict) else value


def _text(value: Any) -> str:
    if isinstance(value, bool):
        return "yes" if value else "no"
    return f"{value:.3g}" if isinstance(value, float) else "–" if value is None else plain(str(value))
