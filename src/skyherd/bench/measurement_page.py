"""Common parts of the page and the Markdown of a measurement."""

from collections.abc import Mapping, Sequence
from pathlib import Path

from skyherd.bench.set_result import SetResult
from skyherd.bench.table import Table, markdown_page, plain_text
from skyherd.files.atomic import write_text
from skyherd.plots.panels import FigureFile
from skyherd.report.pages import Tile, figure_card, render_page


def write_page(
    folder: Path,
    name: str,
    *,
    title: str,
    tiles: Sequence[Tile],
    figures: Sequence[FigureFile],
    tables: Sequence[Table],
    environment: Mapping[str, object],
    refused: Sequence[tuple[str, str, str]] = (),
    **own: object,
) -> Path:
    """Write `NAME.html` and `NAME.md` into a folder, and return the path of the page.

    Args:
        folder: folder of the result.
        name: name of both files, and of the page's template, which extends `measurement.html`.
        title: title of the page.
        tiles: the result in a few numbers.
        figures: figures to embed, in the order shown.
        tables: tables of the result, in the order shown.
        environment: programs and machine of the measurement.
        refused: set, detector, and the reason why the detector cannot read the set.
        **own: additional variables of the page's template.

    Raises:
        OutputError: a file could not be written.
    """
    write_text(folder / f"{name}.md", markdown_page(tables, environment))
    page = render_page(
        "skyherd.bench",
        f"{name}.html",
        title=title,
        tiles=tiles,
        figures=[figure_card(figure) for figure in figures],
        tables=tables,
        environment=[(key.replace("_", " "), plain_text(value)) for key, value in environment.items()],
        refused=refused,
        **own,
    )
    return write_text(folder / f"{name}.html", page)


def set_tiles(result: SetResult) -> list[Tile]:
    """Return the extent of a measurement on photographs: detectors, images, and confirmed markers."""
    first = {row["set"]: row for row in result.rows}
    return [
        Tile(str(len(result.detectors)), "detectors"),
        Tile(str(sum(row["images"] for row in first.values())), "images"),
        Tile(str(sum(row["confirmed"] for row in first.values())), "markers confirmed by two detectors"),
    ]
