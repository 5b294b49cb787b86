"""Page of a measurement on photographs: `photographs.html`, Markdown, figure and contact sheets."""

from collections.abc import Sequence
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

SHEETS = ("missed", "unconfirmed")
"""Kinds of contact sheets; a detector may have one of each."""


def output_names(detectors: Sequence[str]) -> list[str]:
    """Return the names of all possible outputs of these detectors, relative to the folder."""
    figures = [f"figures/{panel.name}{kind}" for panel in PANELS for kind in (".png", ".svg")]
    sheets = [f"figures/{_stem(kind, name)}.png" for kind in SHEETS for name in detectors]
    return [RESULT, MISSED, UNCONFIRMED, PAGE, MARKDOWN, *figures, *sheets]


def write_outputs(result: PhotographsResult, measured: Measurement, folder: Path) -> Path:
    """Write page, Markdown, figure and contact sheets into a folder, and return the path of the page.

    Raises:
        OutputError: a file could not be written.
    """
    figures_folder = folder / "figures"
    figures = write_panels(PANELS, result, figures_folder)
    sheets = [
        *_sheets(measured.missed_tiles, figures_folder, SHEETS[0], "Confirmed, but missed by {}"),
        *_sheets(measured.unconfirmed_tiles, figures_folder, SHEETS[1], "Found by {}, but not confirmed"),
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
        stem = _stem(kind, name)
        heading = title.format(name)
        caption = f"{len(places)} places; id, side, file and the detectors that find it."
        made.append(FigureFile(stem, heading, caption, write_sheet(places, folder / f"{stem}.png")))
    return made


def _stem(kind: str, detector: str) -> str:
    """Return the file name, without suffix, of a detector's contact sheet."""
    return f"{kind}_{detector.replace(':', '_')}"
