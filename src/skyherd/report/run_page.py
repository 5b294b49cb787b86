"""Page of one run: status, video, figures, explained summary, and scenario."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from skyherd.analysis.history import History
from skyherd.analysis.summary_fields import GROUPS, Field, value_text
from skyherd.analysis.topology_report import NOT_REQUIRED, required_conditions
from skyherd.files.atomic import write_text
from skyherd.plots.panels import FigureFile
from skyherd.report.pages import Tile, figure_card, render_page, video_card

PAGE, VIDEO, PHONE_VIDEO = "report.html", "video.mp4", "video-phone.mp4"
"""Files in a run's folder: the page, and the videos that it shows."""

REPLAY = "replay.html"
"""File in a run's folder with the run in 3-D, which the page shows if it exists."""

PAPER = "https://doi.org/10.1109/TCST.2018.2834308"
"""Address of the paper whose controller the runs use."""

TILES = ("reached_s", "shape_error", "min_separation_m", "detection_recall", "scale", "simulated_s")
"""Summary keys highlighted at the top of the page, in this order."""


@dataclass(frozen=True)
class SummaryRow:
    """One value of the summary: label, text with unit, and meaning."""

    label: str
    value: str
    meaning: str


@dataclass(frozen=True)
class SummaryTable:
    """A named group of the summary's values."""

    name: str
    rows: list[SummaryRow]


def write_page(
    folder: Path,
    history: History,
    summary: Mapping[str, object],
    figures: list[FigureFile],
    versions: Mapping[str, str],
    scenario_text: str,
    *,
    embed: bool = False,
) -> Path:
    """Write `report.html` into a run's folder, with the folder's videos and replay if there are any.

    Args:
        folder: the run's output folder.
        history: the run.
        summary: its summary, with the keys of `summary.json`.
        figures: files to embed, in the order shown.
        versions: versions of the run's programs, by name.
        scenario_text: the whole scenario, as TOML or JSON.
        embed: put videos and replay into the page, which shows them from beside it otherwise.

    Returns:
        the path of the page.

    Raises:
        OutputError: the page could not be written.
    """
    scenario = history.mission.scenario
    fields = {field.key: field for group in GROUPS.values() for field in group}
    videos = (VIDEO, "wide"), (PHONE_VIDEO, "phone")
    positions_m = summary.get("final_positions_m")
    page = render_page(
        "skyherd.report",
        "report.html",
        title=scenario.name,
        description=scenario.description,
        is_good=summary["complete"] and summary["converged"],
        status=_status(summary),
        videos=[
            video_card(folder / name, shape, embed=embed)
            for name, shape in videos
            if (folder / name).exists()
        ],
        replay=_replay_attributes(folder / REPLAY, embed=embed),
        paper=PAPER,
        tiles=[Tile(value_text(fields[key], summary.get(key)), fields[key].label) for key in TILES],
        figures=[figure_card(figure) for figure in figures],
        tables=_tables(summary, required_conditions(history.mission)),
        positions=[
            {"robot": robot, "x_m": x_m, "y_m": y_m}
            for robot, (x_m, y_m) in (positions_m if isinstance(positions_m, Mapping) else {}).items()
        ],
        scenario=scenario_text,
        versions=versions,
    )
    return write_text(folder / PAGE, page)


def _replay_attributes(path: Path, *, embed: bool) -> dict[str, str]:
    """Return the attribute of a frame that shows the replay; none if there is no replay."""
    if not path.exists():
        return {}
    return {"srcdoc": path.read_text("utf-8")} if embed else {"src": path.name}


def _status(summary: Mapping[str, object]) -> str:
    """Return the sentence at the top of the page: defects of the recording, if any, and the verdict.

    No line breaks between a number and its per cent sign.
    """
    flaws, verdict = str(summary.get("recording", "")), str(summary["verdict"])
    if flaws and not flaws.startswith("cut short"):
        verdict = f"The recording is not intact ({flaws}). {verdict}"
    return verdict.replace(" %", "\N{NO-BREAK SPACE}%")


def _meaning(field: Field, required: int) -> str:
    """Return a field's explanation; that of a condition above TC`required` says that it is not required."""
    spared = [f"tc{number}_violation_s" for number in range(required + 1, 6)]
    return f"{field.meaning} {NOT_REQUIRED.capitalize()}." if field.key in spared else field.meaning


def _tables(summary: Mapping[str, object], required: int) -> list[SummaryTable]:
    """Return a table for each group of fields with values, and one for keys without a group.

    Args:
        summary: the run's summary.
        required: number of conditions TC1, TC2, … that the mission requires.
    """
    known = {field.key for group in GROUPS.values() for field in group} | {"final_positions_m"}
    groups = {**GROUPS, "Other": tuple(Field(key, key) for key in summary if key not in known)}
    tables = [
        SummaryTable(
            name,
            [
                SummaryRow(field.label, value_text(field, summary[field.key]), _meaning(field, required))
                for field in fields
                if field.key in summary
            ],
        )
        for name, fields in groups.items()
    ]
    return [table for table in tables if table.rows]
