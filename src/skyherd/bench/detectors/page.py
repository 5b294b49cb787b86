"""Page, Markdown and figures of the benchmark: `bench.html`, `bench.md` and `figures/`."""

from pathlib import Path

from skyherd.bench.detectors.plots import PLOTS, write_plots
from skyherd.bench.detectors.tables import make_tables
from skyherd.bench.measurement_page import write_page
from skyherd.bench.result import RESULT, Result
from skyherd.bench.table import short
from skyherd.report.pages import Tile

PAGE, MARKDOWN = "bench.html", "bench.md"
"""File names in the result's folder."""


def output_names() -> list[str]:
    """Return the names of all possible outputs of a benchmark, relative to its folder."""
    figures = [f"figures/{plot.name}{kind}" for plot in PLOTS for kind in (".png", ".svg")]
    return [RESULT, MARKDOWN, PAGE, *figures]


def write_outputs(result: Result, folder: Path) -> Path:
    """Write figures, Markdown and page of a result into a folder, and return the path of the page.

    Raises:
        OutputError: a file could not be written.
    """
    return write_page(
        folder,
        "bench",
        title="Marker detectors",
        tiles=_tiles(result),
        figures=write_plots(result, folder / "figures"),
        tables=make_tables(result),
        environment=result.environment,
    )


def _tiles(result: Result) -> list[Tile]:
    """Return the run in a few numbers: its extent, and the best accuracy in the base cell."""
    images = sum(row["images"] for row in result.cells[:: max(len(result.detectors), 1)])
    markers = sum(row["markers"] for row in result.cells[:: max(len(result.detectors), 1)])
    tiles = [
        Tile(str(len(result.detectors)), "detectors"),
        Tile(f"{images:,}".replace(",", " "), "images a detector"),
        Tile(f"{markers:,}".replace(",", " "), "markers in them"),
    ]
    best = [
        (row["ratio_px"], row["detector"])
        for row in result.cells
        if row["sweep"] == "base" and row["ratio_px"] is not None
    ]
    if best:
        ratio, name = min(best)
        label = "least position RMSE over bound, 30 px, noise 5"
        tiles.append(Tile(f"{short(ratio)} ({name})", label))
    return tiles
