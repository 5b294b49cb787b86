"""Report of a live run: figures, summary and page, from the recordings of its processes."""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

from skyherd.analysis.summary_fields import UNKNOWN, number_text
from skyherd.files.atomic import write_text
from skyherd.files.output_folder import OutputFolder
from skyherd.jobs.progress import NO_PROGRESS, Progress
from skyherd.live.review.figures import PANELS
from skyherd.live.review.latency import Stage, latency_stages
from skyherd.live.review.process_history import ProcessHistory
from skyherd.live.review.reasons import driving_share, time_by_reason
from skyherd.live.review.session_history import SessionHistory, clock_of, read_session
from skyherd.live.robot_core import DRIVING
from skyherd.plots.panels import write_panels
from skyherd.report.pages import Tile, figure_card, render_page
from skyherd.report.run_page import SummaryRow

PAGE, SUMMARY, FIGURES = "report.html", "summary.json", "figures"
"""Names of the page, the summary and the folder of figures, as for a simulated run."""

VERB = "report"
"""Verb of this report in the folder's record."""

END_S = 1.0
"""Time over which the final shape error is a median, s. Chosen: it averages noise; a converging shape changes
by a quarter in five times that."""

MAX_LINES = 300
"""Largest number of status lines on the page. Chosen: a few pages of text."""


@dataclass(frozen=True)
class Table:
    """A table of the page: heading, explanation, column names and rows."""

    title: str
    note: str
    header: tuple[str, ...]
    rows: list[tuple[str, ...]]


def make_live_report(folder: Path, progress: Progress = NO_PROGRESS) -> dict[str, Any]:
    """Make figures, summary and page of a live run in its folder, and return the summary.

    The key `recording` of the summary describes flaws of the recordings, if any.

    Args:
        folder: a folder of `skyherd live run`.
        progress: receives the number of files read.

    Raises:
        InputError: the folder has no readable recording, or the report would replace a file that skyherd did
            not make.
        OutputError: a file cannot be written.
    """
    session = read_session(folder, progress)
    figures = [f"{FIGURES}/{panel.name}{kind}" for panel in PANELS for kind in (".png", ".svg")]
    with OutputFolder(folder, VERB, [SUMMARY, PAGE, *figures], resume=True, elsewhere=None):
        summary = summarize_session(session)
        cards = [figure_card(figure) for figure in write_panels(PANELS, session, folder / FIGURES)]
        write_text(folder / SUMMARY, json.dumps(summary, indent=2) + "\n")
        page = render_page(
            "skyherd.live.review",
            "live.html",
            title=f"Team {session.lab.model.team}",
            lead=_lead(session),
            is_good=not session.flaws,
            status=_status(session),
            tiles=_tiles(session, summary),
            figures=cards,
            stages=[_stage_row(stage) for stage in latency_stages(session)],
            tables=[table for table in _tables(session) if table.rows],
            lines=_lines(session),
            lab=json.dumps(session.lab.model.model_dump(mode="json", exclude_none=True), indent=2),
            versions=sorted({log.version for logs in session.runs.values() for log in logs}),
        )
        write_text(folder / PAGE, page)
    return summary


def summarize_session(session: SessionHistory) -> dict[str, Any]:
    """Return the summary of a live run as a JSON object. Unknown values are None."""
    robots = list(session.logs("robot"))
    summary: dict[str, Any] = {
        "team": session.lab.model.team,
        "recorded_s": session.end_s,
        "images": sum(len(log.stages) for log in session.logs("unit")),
        "pictures_not_looked_at": sum(log.lost_pictures for log in session.logs("unit")),
        "decisions": sum(len(log.decided) for log in robots),
        "shape_error": {log.name: _end_error(session, log) for log in _last_runs(session, "unit")},
        "latency_s": {
            stage.key: {
                "median": _known(stage.median_s),
                "p99": _known(stage.p99_s),
                "count": int(stage.times_s.size),
            }
            for stage in latency_stages(session)
        },
        "driving_share": _known(driving_share(session, robots)),
        "restarts": session.restarts,
        "refused": session.refused,
    }
    return summary | ({"recording": session.flaw_line} if session.flaws else {})


def _known(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


def _last_runs(session: SessionHistory, kind: str) -> list[ProcessHistory]:
    """Return the last recording of each process of a kind."""
    return [logs[-1] for name, logs in session.runs.items() if name.startswith(f"{kind}/")]


def _end_error(session: SessionHistory, log: ProcessHistory) -> float | None:
    """Return the median shape error of a unit's last images, or None without one."""
    errors = [(judged.time_s, judged.shape_error) for judged in log.judged if np.isfinite(judged.shape_error)]
    last = [error for time_s, error in errors if time_s >= errors[-1][0] - END_S]
    return float(np.median(last)) if last else None


def _lead(session: SessionHistory) -> str:
    begun = datetime.fromtimestamp(max(0.0, min(session.zero_s, 1e10)), UTC)
    units, robots = len(session.lab.model.cameras), len(session.lab.ids)
    cameras = f"{units} camera{'s' * (units > 1)}"
    return f"{robots} robots under {cameras}, from {begun:%Y-%m-%d %H:%M:%S} UTC for {session.end_s:.0f} s."


def _status(session: SessionHistory) -> str:
    """Return the status sentence of the page: whether the recordings are complete."""
    count = sum(len(logs) for logs in session.runs.values())
    if session.flaws:
        return f"The recording is incomplete ({session.flaw_line}). The page shows its readable part."
    return f"All {count} recordings are complete, and all processes ended in order."


def _tiles(session: SessionHistory, summary: dict[str, Any]) -> list[Tile]:
    errors = [error for error in summary["shape_error"].values() if error is not None]
    whole = summary["latency_s"]["whole"]
    share = summary["driving_share"]
    return [
        Tile(
            f"{100 * max(errors):.3g} %" if errors else UNKNOWN,
            "final shape error, as estimated by the units" + ("; the largest" if len(errors) > 1 else ""),
        ),
        Tile(_ms(whole["median"]), "capture → command, median"),
        Tile(_ms(whole["p99"]), "capture → command, 99th percentile"),
        Tile(UNKNOWN if share is None else f"{100 * share:.3g} %", "of the time, robots drove"),
        Tile(str(session.restarts), "restarts of processes"),
        Tile(str(session.refused), "messages refused"),
    ]


def _ms(value_s: float | None) -> str:
    return (
        UNKNOWN
        if value_s is None or not np.isfinite(value_s)
        else f"{number_text(float(f'{1e3 * value_s:.3g}'))} ms"
    )


def _tables(session: SessionHistory) -> list[Table]:
    return [
        Table(
            "Processes",
            "All starts of each process together. Other reasons: the longest reason for standing still.",
            ("process", "starts", "decisions", "drove", "other reasons", "refused", "dropped", "end"),
            [_process_row(session, logs) for logs in session.runs.values()],
        ),
        Table(
            "Clocks",
            "For each process, the unit whose clock offset is least certain, estimated from the time stamps "
            "of messages; medians over the run.",
            ("process", "compared with", "offset", "uncertainty"),
            [row for name in session.runs for row in _clock_rows(session, name)],
        ),
        Table(
            "Refused messages",
            "",
            ("process", "reason", "count"),
            [
                (name, why, str(count))
                for name, logs in session.runs.items()
                for log in logs
                for why, count in log.refused.items()
            ],
        ),
    ]


def _stage_row(stage: Stage) -> SummaryRow:
    times = f"{_ms(stage.median_s)}, {_ms(stage.p99_s)}" if stage.times_s.size else UNKNOWN
    return SummaryRow(stage.name, times, f"{stage.meaning} Measured {stage.times_s.size} times.")


def _process_row(session: SessionHistory, logs: Sequence[ProcessHistory]) -> tuple[str, ...]:
    others = {reason: s for reason, s in time_by_reason(session, logs).items() if reason != DRIVING}
    is_unit = logs[0].is_unit
    share = driving_share(session, logs)
    drove = "" if is_unit else UNKNOWN if np.isnan(share) else f"{100 * share:.3g} %"
    mostly = "" if is_unit or not others else "{} ({:.1f} s)".format(*next(iter(others.items())))
    decided = sum(len(log.stages) if is_unit else len(log.decided) for log in logs)
    refused, dropped = sum(sum(log.refused.values()) for log in logs), sum(log.dropped for log in logs)
    ended = "in order" if logs[-1].ended else "killed, or still running"
    return logs[0].name, str(len(logs)), str(decided), drove, mostly, str(refused), str(dropped), ended


def _clock_rows(session: SessionHistory, name: str) -> list[tuple[str, ...]]:
    """Return a row for the unit whose clock offset is least certain."""
    log = session.runs[name][-1]
    units = [other for other in session.runs if other.startswith("unit/") and other != name]
    if not units:
        return []
    worst = max(units, key=lambda unit: clock_of(log, unit).uncertainty_s)
    known = clock_of(log, worst)
    if not known.is_known:
        return [(name, worst, UNKNOWN, UNKNOWN)]
    return [(name, worst, _ms(known.offset_s), f"± {_ms(known.uncertainty_s)}")]


def _lines(session: SessionHistory) -> list[str]:
    """Return the status lines of all processes, with their starts and ends, in order."""
    timed_lines: list[tuple[float, str]] = []
    for name, logs in session.runs.items():
        for number, log in enumerate(logs):
            began_s, ended_s = session.times_s(log, log.times_s).tolist()
            timed_lines.append((began_s, f"{name}: {'re' * bool(number)}started"))
            timed_lines.append((ended_s, f"{name}: {'ended' if log.ended else 'its recording is cut off'}"))
            times_s = session.times_s(log, [time_s for time_s, _ in log.lines]).tolist()
            texts = [line.removeprefix(f"{name}: ") for _, line in log.lines]
            timed_lines += [(time_s, f"{name}: {text}") for time_s, text in zip(times_s, texts, strict=True)]
    lines = [f"{time_s:8.2f} s  {line}" for time_s, line in sorted(timed_lines)]
    more = len(lines) - MAX_LINES
    return lines[:MAX_LINES] + [f"… and {more} more"] * (more > 0)
