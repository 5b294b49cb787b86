"""The page of a measurement on photographs: `photographs.html`, its Markdown, figure and contact sheets."""

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from skyherd.bench.entrants import is_ours
from skyherd.bench.photographs.contact_sheet import PlaceTile, write_sheet
from skyherd.bench.photographs.measurement import Measurement
from skyherd.bench.photographs.result import MISSED, RESULT, UNCONFIRMED, PhotographsResult
from skyherd.bench.photographs.tables import make_tables
from skyherd.bench.plots import OTHER_COLORS, OUR_COLORS
from skyherd.bench.tables import markdown_page, plain_text
from skyherd.files.atomic import write_text
from skyherd.plots.panels import FigureFile, save_figure
from skyherd.plots.style import drawing_style, legend_above, new_figure
from skyherd.report.pages import Tile, figure_card, render_page

PAGE, MARKDOWN = "photographs.html", "photographs.md"
"""File names in the result's folder."""

OUTPUT_NAMES = (RESULT, MISSED, UNCONFIRMED, PAGE, MARKDOWN, "figures/")
"""All that is written into the result's folder, relative to it."""


def write_page(result: PhotographsResult, measured: Measurement, folder: Path) -> Path:
    """Write page, Markdown, figure and contact sheets into a folder, and return the path of the page.

    Raises:
        OutputError: a file could not be written.
    """
    figures_folder = folder / "figures"
    figures_folder.mkdir(parents=True, exist_ok=True)
    with drawing_style():
        figures = [
            save_figure(
                draw_recall(result),
                figures_folder,
                "recall",
                "Recall",
                "Share of the markers that two independent detectors confirm.",
            )
        ]
    sheets = [
        *_sheets(measured.missed_tiles, figures_folder, "missed", "Confirmed, but missed by {}"),
        *_sheets(measured.unconfirmed_tiles, figures_folder, "unconfirmed", "Found by {}, but not confirmed"),
    ]
    tables = make_tables(result)
    write_text(folder / MARKDOWN, markdown_page(tables, result.environment))
    page = render_page(
        "skyherd.bench",
        PAGE,
        title="Markers on photographs",
        tiles=_tiles(result),
        figures=[figure_card(figure) for figure in figures],
        sheets=[figure_card(sheet) for sheet in sheets],
        refused=[
            (name, detector, why)
            for name, of_set in result.refused.items()
            for detector, why in of_set.items()
        ],
        tables=tables,
        environment=[(key.replace("_", " "), plain_text(value)) for key, value in result.environment.items()],
    )
    return write_text(folder / PAGE, page)


def draw_recall(result: PhotographsResult) -> Figure:
    """Draw recall in each set as bars, one for each detector that can read it."""
    figure = new_figure(4.2, 11.0)
    axes = figure.subplots()
    names, sets = result.detectors, [name for name in result.sets if name not in result.unread()]
    width = 0.85 / max(len(names), 1)
    ours, others = iter(OUR_COLORS), iter(OTHER_COLORS)
    for index, name in enumerate(names):
        rows = [result.row(set_name, name) for set_name in sets]
        heights = [np.nan if row is None or row["recall"] is None else row["recall"] for row in rows]
        places = np.arange(len(sets)) + width * (index - (len(names) - 1) / 2)
        color = next(ours, OUR_COLORS[-1]) if is_ours(name) else next(others, OTHER_COLORS[-1])
        axes.bar(places, heights, width, label=name, color=color)
    axes.set_xticks(range(len(sets)), sets)
    axes.set(ylim=(0, 1.02), ylabel="recall")
    axes.grid(visible=False, axis="x")
    legend_above(figure, columns=5)
    return figure


def _sheets(tiles: dict[str, list[PlaceTile]], folder: Path, kind: str, title: str) -> list[FigureFile]:
    made = []
    for name, places in tiles.items():
        stem = f"{kind}_{name.replace(':', '_')}"
        heading = title.format(name)
        caption = f"{len(places)} places; id, side, file and the detectors that find it."
        made.append(FigureFile(stem, heading, caption, write_sheet(places, folder / f"{stem}.png")))
    return made


def _tiles(result: PhotographsResult) -> list[Tile]:
    """The run in a few numbers."""
    first = {row["set"]: row for row in result.rows}
    tiles = [
        Tile(str(len(result.detectors)), "detectors"),
        Tile(str(sum(row["images"] for row in first.values())), "images"),
        Tile(str(sum(row["confirmed"] for row in first.values())), "markers confirmed by two detectors"),
    ]
    return tiles
