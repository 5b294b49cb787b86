"""A study's table as Markdown and as the figures that its file describes."""

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
from skyherd.plots.style import DPI, drawing_style, new_figure
from skyherd.study.spec import SUMMARY_FIELDS, FigureModel, Study, StudySpec
from skyherd.study.store import ERROR
from skyherd.study.table import SWEEP, Row, good_rows

MARKDOWN = "table.md"
MARKS = "osD^vPX<"
MOST_ERRORS = 5
MOST_TICKS = 9


def write_figure_pages(study: Study, table: pa.Table, folder: Path) -> list[Path]:
    """Write `table.md`, and a PNG for each figure of the study that has anything to show.

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
    """A figure of the runs that went well: for each line and x the median, and the range; None without any.

    Where x is drawn at random, each run is a dot.
    """
    shown = [
        row
        for row in rows
        if model.sweep in (None, row.get(SWEEP)) and row[model.x] is not None and _is_number(row[model.y])
    ]
    if not shown:
        return None
    figure = new_figure(4.2)
    axes = figure.subplots()
    places = _places(axes, [row[model.x] for row in shown], log=model.x_log)
    lines = _distinct(row[model.lines] for row in shown) if model.lines else [None]
    for index, line in enumerate(lines):
        mine = [row for row in shown if model.lines is None or row[model.lines] == line]
        points = [(places[_hashable(row[model.x])], float(row[model.y])) for row in mine]
        style = {"color": UNIT_COLORS[index % len(UNIT_COLORS)], "marker": MARKS[index % len(MARKS)]}
        _draw_points(axes, points, dots=model.x in spec.drawn, label=_word(line), **style)
    axes.set_title(model.title)
    axes.set_xlabel(model.x_label or model.x)
    axes.set_ylabel(model.y_label or field_label(model.y))
    if model.y_log and any(row[model.y] > 0 for row in shown):
        axes.set_yscale("log", nonpositive="mask")
    if model.lines:
        figure.legend(title=model.lines_label or model.lines, loc="outside right upper")
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
    axes.errorbar(xs, middle, yerr=reach, capsize=3, elinewidth=0.9, markersize=5, **style)


def _places(axes: Axes, values: Sequence[Any], *, log: bool) -> dict[Any, float]:
    """Where values of x lie: numbers where they are, all else side by side under its name."""
    distinct = _distinct(values)
    if all(_is_number(value) for value in distinct):
        if log and distinct[0] > 0:
            axes.set_xscale("log")
        if len(distinct) <= MOST_TICKS:
            axes.set_xticks(distinct, [_word(value) for value in distinct])
            axes.xaxis.set_minor_formatter(NullFormatter())
        elif not log:
            axes.xaxis.set_major_formatter(ScalarFormatter())
        return {value: float(value) for value in distinct}
    axes.set_xticks(range(len(distinct)), [_word(value) for value in distinct])
    return {_hashable(value): float(place) for place, value in enumerate(distinct)}


def markdown_table(spec: StudySpec, table: pa.Table) -> str:
    """A row for each combination of what is neither seed nor drawn: runs, failures, medians and ranges."""
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
                *(_word(rows[0][key]) for key in keys),
                str(len(rows)),
                str(len(rows) - len(good)),
                *(_spread([row[name] for row in good]) for name in fields),
            ]
        )
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def field_label(name: str) -> str:
    """A field of the summary in plain words, with its unit."""
    field = SUMMARY_FIELDS[name]
    unit = "rad" if field.kind == "angle" else field.unit
    return f"{field.label} ({unit})" if unit else field.label


def _spread(values: list[Any]) -> str:
    """Median and range of numbers, share of truths, all texts."""
    known = [value for value in values if value is not None]
    if not known:
        return "–"
    if all(isinstance(value, bool) for value in known):
        return f"{sum(known)} of {len(known)}"
    if not all(_is_number(value) for value in known):
        return ", ".join(map(_word, _distinct(known)))
    low, middle, high = (_word(float(value)) for value in np.quantile(known, (0, 0.5, 1)))
    return middle if low == high else f"{middle} ({low} to {high})"


def complaints(table: pa.Table) -> list[str]:
    """Each error of the failed runs, the commonest first."""
    errors = Counter(error for error in table[ERROR].to_pylist() if error is not None)
    lines = [f"- {count} failed: {error}" for error, count in errors.most_common(MOST_ERRORS)]
    more = len(errors) - len(lines)
    return (
        ["\n".join([*lines, *([f"- and {more} other errors, in the column `error`"] if more > 0 else [])])]
        if lines
        else []
    )


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and bool(np.isfinite(value))


def _distinct(values: Iterable[Any]) -> list[Any]:
    """Each value once: numbers ascending, all else as it came."""
    distinct = list({_hashable(value): value for value in values}.values())
    return sorted(distinct) if all(_is_number(value) for value in distinct) else distinct


def _hashable(value: Any) -> Any:
    return str(value) if isinstance(value, list | dict) else value


def _word(value: Any) -> str:
    if isinstance(value, bool):
        return "yes" if value else "no"
    return f"{value:.3g}" if isinstance(value, float) else "–" if value is None else str(value)
