"""The page on a run."""

from collections.abc import Mapping
from html import escape
from pathlib import Path

from skyherd.analysis.history import History
from skyherd.analysis.summary_fields import GROUPS, Field, number_text, value_text
from skyherd.files.atomic import write_text
from skyherd.plots.panels import FigureFile
from skyherd.report.pages import data_uri, figure_card, html_page, tile

PAGE, VIDEO = "report.html", "video.mp4"
TILES = ("shape_error", "scale", "min_separation_m", "detection_recall", "simulated_s", "real_time_factor")


def write_page(
    folder: Path,
    history: History,
    summary: Mapping[str, object],
    figures: list[FigureFile],
    versions: Mapping[str, str],
    scenario_text: str,
) -> Path:
    """Write `report.html` into a run's folder, with the folder's `video.mp4` in it if there is one.

    Args:
        folder: the run's output folder.
        history: the run.
        summary: its summary, with the keys of `summary.json`.
        figures: files to embed, in the order shown.
        versions: of the programs that made the run, by name.
        scenario_text: the whole scenario, as TOML or JSON.

    Raises:
        OutputError: the page could not be written.
    """
    scenario = history.mission.scenario
    status_class, status = _status(summary, scenario.duration_s)
    page = html_page(
        "skyherd.report",
        "report",
        scenario.name,
        name=escape(scenario.name),
        description=escape(scenario.description),
        status_class=status_class,
        status=escape(status),
        video=_video(folder / VIDEO),
        tiles="\n".join(
            tile(value_text(field, summary.get(field.key)), field.label)
            for key in TILES
            for field in _fields()
            if field.key == key
        ),
        figures="\n".join(figure_card(figure) for figure in figures),
        tables=_tables(summary),
        scenario=escape(scenario_text),
        versions=" · ".join(escape(f"{name} {version}") for name, version in versions.items()),
    )
    return write_text(folder / PAGE, page)


def _status(summary: Mapping[str, object], planned_s: float) -> tuple[str, str]:
    """Class and words of the line that says how the run went."""
    formed = "the shape was formed and held" if summary["converged"] else "the shape was not formed and held"
    if not summary["complete"]:
        lasted = value_text(Field("simulated_s", "", "s"), summary["simulated_s"])
        return "bad", f"Cut short after {lasted} of {number_text(planned_s)} s; until then, {formed}."
    if summary["converged"]:
        return "good", f"Converged: {formed} to the end."
    return "bad", f"Not converged: {formed} to the end."


def _video(path: Path) -> str:
    if not path.exists():
        return ""
    source = data_uri(path, "video/mp4")
    return (
        '<video controls muted playsinline preload="auto" aria-label="Video of the run" '
        f'src="{source}"></video>'
    )


def _fields() -> list[Field]:
    return [field for group in GROUPS.values() for field in group]


def _tables(summary: Mapping[str, object]) -> str:
    """A table for each group of fields, and one for keys that no group has."""
    groups = dict(GROUPS)
    known = {field.key for field in _fields()} | {"final_positions_m"}
    if others := tuple(Field(key, key) for key in summary if key not in known):
        groups["Other"] = others
    shown = {name: fields for name, fields in groups.items() if any(field.key in summary for field in fields)}
    tables = [_table(name, fields, summary) for name, fields in shown.items()]
    return "\n".join([*tables, _positions(summary.get("final_positions_m"))])


def _table(name: str, fields: tuple[Field, ...], summary: Mapping[str, object]) -> str:
    rows = [
        f'<tr><th scope="row">{escape(field.label)}</th>'
        f"<td>{escape(value_text(field, summary[field.key]))}</td><td>{escape(field.meaning)}</td></tr>"
        for field in fields
        if field.key in summary
    ]
    return f"<table><caption>{escape(name)}</caption><tbody>\n" + "\n".join(rows) + "\n</tbody></table>"


def _positions(positions_m: object) -> str:
    """Where each robot ended, folded away."""
    if not isinstance(positions_m, Mapping):
        return ""
    items = "\n".join(
        f"<li>{escape(str(robot))}: ({x_m:.3f}, {y_m:.3f}) m</li>"
        for robot, (x_m, y_m) in positions_m.items()
    )
    return (
        '<details class="block"><summary>Final positions of the robots (x, y)</summary>'
        f'<ul class="positions">\n{items}\n</ul></details>'
    )
