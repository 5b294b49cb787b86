"""Page of a measurement on boards: `boards.html`, its Markdown and its figures."""

from pathlib import Path

from skyherd.bench.boards.measurement import Measurement
from skyherd.bench.boards.plots import make_panels
from skyherd.bench.boards.tables import fine, make_tables
from skyherd.bench.measurement_page import set_tiles, write_page
from skyherd.bench.set_result import SetResult
from skyherd.plots.panels import write_panels
from skyherd.report.pages import Tile

PAGE, MARKDOWN, RESULT = "boards.html", "boards.md", "boards.json"
"""File names in the result's folder."""

FIGURES = ("distributions", "medians", "boards")
"""Names of the possible figures of `skyherd.bench.boards.plots.make_panels`."""

OUTPUT_NAMES = (
    RESULT,
    PAGE,
    MARKDOWN,
    *(f"figures/{name}{kind}" for name in FIGURES for kind in (".png", ".svg")),
)
"""All possible outputs in the result's folder, relative to it."""


def write_outputs(result: SetResult, measured: Measurement, folder: Path) -> Path:
    """Write JSON, page, Markdown and figures into a folder, and return the path of the page.

    Raises:
        OutputError: a file could not be written.
    """
    result.write(folder / RESULT)
    return write_page(
        folder,
        "boards",
        title="Accuracy on boards",
        tiles=_tiles(result),
        figures=write_panels(make_panels(result), measured, folder / "figures"),
        tables=make_tables(result),
        environment=result.environment,
        refused=result.refusals(),
    )


def _tiles(result: SetResult) -> list[Tile]:
    """Return the run in a few numbers: its extent, and the least error."""
    tiles = set_tiles(result)
    best = [(row["center_px"], row["detector"], row["set"]) for row in result.rows if row["center_px"]]
    if best:
        value, detector, name = min(best)
        tiles.append(Tile(f"{fine(value)} px", f"least median error of the centre: {detector}, {name}"))
    return tiles
