"""The page of a measurement on boards: `boards.html`, its Markdown and its figures."""

from pathlib import Path

from skyherd.bench.boards.measurement import Measurement
from skyherd.bench.boards.plots import draw_boards, draw_distributions, draw_medians
from skyherd.bench.boards.tables import fine, make_tables
from skyherd.bench.set_result import SetResult
from skyherd.bench.tables import markdown_page, plain_text
from skyherd.files.atomic import write_text
from skyherd.plots.panels import FigureFile, save_figure
from skyherd.plots.style import drawing_style
from skyherd.report.pages import Tile, figure_card, render_page

PAGE, MARKDOWN, RESULT = "boards.html", "boards.md", "boards.json"
"""File names in the result's folder."""

OUTPUT_NAMES = (RESULT, PAGE, MARKDOWN, "figures/")
"""All that is written into the result's folder, relative to it."""


def write_outputs(result: SetResult, measured: Measurement, folder: Path) -> Path:
    """Write JSON, page, Markdown and figures into a folder, and return the path of the page.

    Raises:
        OutputError: a file could not be written.
    """
    figures = _write_figures(result, measured, folder / "figures")
    tables = make_tables(result)
    result.write(folder / RESULT)
    write_text(folder / MARKDOWN, markdown_page(tables, result.environment))
    page = render_page(
        "skyherd.bench",
        PAGE,
        title="Accuracy on boards",
        tiles=_tiles(result),
        figures=[figure_card(figure) for figure in figures],
        refused=[(name, *pair) for name, of_set in result.refused.items() for pair in of_set.items()],
        tables=tables,
        environment=[(key.replace("_", " "), plain_text(value)) for key, value in result.environment.items()],
    )
    return write_text(folder / PAGE, page)


def _write_figures(result: SetResult, measured: Measurement, folder: Path) -> list[FigureFile]:
    folder.mkdir(parents=True, exist_ok=True)
    with drawing_style():
        drawn = (
            (
                "distributions",
                "Errors of the centre",
                "Share of the markers found whose centre is off by less than a distance; the dotted line is "
                "the floor's median.",
                draw_distributions(result, measured),
            ),
            (
                "medians",
                "Median errors",
                "Of centre, corners and heading, in each set; the short line is the floor that all detectors "
                "share.",
                draw_medians(result),
            ),
            (
                "boards",
                "What the boards have wrong",
                "Displacement of each corner from where the layout has it, learned from all detectors and "
                "images; arrows are longer than they are.",
                draw_boards(measured),
            ),
        )
        return [
            save_figure(figure, folder, name, title, caption)
            for name, title, caption, figure in drawn
            if figure is not None
        ]


def _tiles(result: SetResult) -> list[Tile]:
    """The run in a few numbers."""
    first = {row["set"]: row for row in result.rows}
    tiles = [
        Tile(str(len(result.detectors)), "detectors"),
        Tile(str(sum(row["images"] for row in first.values())), "images"),
        Tile(str(sum(row["confirmed"] for row in first.values())), "markers confirmed by two detectors"),
    ]
    best = [(row["center_px"], row["detector"], row["set"]) for row in result.rows if row["center_px"]]
    if best:
        value, detector, name = min(best)
        tiles.append(Tile(f"{fine(value)} px", f"least median error of the centre: {detector}, {name}"))
    return tiles
