"""The page of a measurement on photographs: `photographs.html`, its Markdown, figure and contact sheets."""

from pathlib import Path

from skyherd.bench.measurement_page import set_tiles, write_page
from skyherd.bench.photographs.contact_sheet import PlaceTile, write_sheet
from skyherd.bench.photographs.measurement import Measurement
from skyherd.bench.photographs.plots import PANELS
from skyherd.bench.photographs.result import MISSED, RESULT, UNCONFIRMED, PhotographsResult
from skyherd.bench.photographs.tables import make_tables
from skyherd.plots.panels import FigureFile, write_panels
from skyherd.report.pages import figure_card

PAGE, MARKDOWN = "photographs.html", "photographs.md"
"""File names in the result's folder."""

OUTPUT_NAMES = (RESULT, MISSED, UNCONFIRMED, PAGE, MARKDOWN, "figures/")
"""All that is written into the result's folder, relative to it."""


def write_outputs(result: PhotographsResult, measured: Measurement, folder: Path) -> Path:
    """Write page, Markdown, figure and contact sheets into a folder, and return the path of the page.

    Raises:
        OutputError: a file could not be written.
    """
    figures_folder = folder / "figures"
    figures = write_panels(PANELS, result, figures_folder)
    sheets = [
        *_sheets(measured.missed_tiles, figures_folder, "missed", "Confirmed, but missed by {}"),
        *_sheets(measured.unconfirmed_tiles, figures_folder, "unconfirmed", "Found by {}, but not confirmed"),
    ]
    return write_page(
        folder,
        "photographs",
        title="Markers on photographs",
        tiles=set_tiles(result),
        figures=figures,
        tables=make_tables(result),
        environment=result.environment,
        refused=result.refusals(),
        sheets=[figure_card(sheet) for sheet in sheets],
    )


def _sheets(tiles: dict[str, list[PlaceTile]], folder: Path, kind: str, title: str) -> list[FigureFile]:
    made = []
    for name, places in tiles.items():
        stem = f"{kind}_{name.replace(':', '_')}"
        heading = title.format(name)
        caption = f"{len(places)} places; id, side, file and the detectors that find it."
        made.append(FigureFile(stem, heading, caption, write_sheet(places, folder / f"{stem}.png")))
    return made
