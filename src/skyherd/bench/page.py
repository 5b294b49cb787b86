"""The benchmark's page, and its Markdown."""

from html import escape
from pathlib import Path

from skyherd.bench.plots import write_plots
from skyherd.bench.result import Result
from skyherd.bench.tables import Table, make_tables, short
from skyherd.files.atomic import write_text
from skyherd.report.pages import figure_card, html_page, tile, wide_table

PAGE, MARKDOWN = "bench.html", "bench.md"


def write_outputs(result: Result, folder: Path) -> Path:
    """Write figures, Markdown and page of a result into a folder; returns the page.

    Raises:
        OutputError: a file could not be written.
    """
    figures = write_plots(result, folder / "figures")
    tables = make_tables(result)
    write_text(folder / MARKDOWN, markdown(result, tables))
    page = html_page(
        "skyherd.bench",
        "bench",
        "Marker detectors",
        tiles="\n".join(tile(value, label) for value, label in _tiles(result)),
        figures="\n".join(figure_card(figure) for figure in figures),
        tables="\n".join(_table(table) for table in tables),
        environment="\n".join(_entry(key, value) for key, value in result.environment.items()),
    )
    return write_text(folder / PAGE, page)


def markdown(result: Result, tables: list[Table]) -> str:
    """The tables in Markdown, with what they were measured on."""
    about = ", ".join(f"{key} {value}" for key, value in result.environment.items() if value is not None)
    return "\n\n".join([*(table.markdown() for table in tables), f"Measured with: {about}."]) + "\n"


def _tiles(result: Result) -> list[tuple[str, str]]:
    """The run in a few numbers."""
    images = sum(row["images"] for row in result.cells[:: max(len(result.detectors), 1)])
    markers = sum(row["markers"] for row in result.cells[:: max(len(result.detectors), 1)])
    tiles = [
        (str(len(result.detectors)), "detectors"),
        (f"{images:,}".replace(",", " "), "images a detector"),
        (f"{markers:,}".replace(",", " "), "markers in them"),
    ]
    best = [
        (row["ratio_px"], row["detector"])
        for row in result.cells
        if row["sweep"] == "base" and row["ratio_px"] is not None
    ]
    if best:
        ratio, name = min(best)
        tiles.append((f"{short(ratio)} ({name})", "least position RMSE over bound, 30 px, noise 5"))
    return tiles


def _entry(key: str, value: object) -> str:
    text = "not installed" if value is None else ", ".join(value) if isinstance(value, list) else str(value)
    return f'<tr><th scope="row">{escape(key.replace("_", " "))}</th><td>{escape(text)}</td></tr>'


def _table(table: Table) -> str:
    return f"""<section class="measured">
<h3>{escape(table.title)}</h3>
<p class="hint">{escape(table.note)}</p>
{wide_table(table.title, table.header, table.rows)}
</section>"""
