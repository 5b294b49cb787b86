"""The benchmark's page: one HTML file that needs no other file, network or script; and its Markdown."""

from html import escape
from importlib.resources import files
from pathlib import Path
from string import Template

from skyherd.bench.plots import write_plots
from skyherd.bench.result import Result
from skyherd.bench.tables import Table, make_tables, short
from skyherd.files import write_text
from skyherd.report import figure_card, page_style

PAGE, MARKDOWN = "bench.html", "bench.md"


def write_outputs(result: Result, folder: Path) -> Path:
    """Write figures, Markdown and page of a result into a folder; returns the page.

    Raises:
        OutputError: a file could not be written.
    """
    figures = write_plots(result, folder / "figures")
    tables = make_tables(result)
    write_text(folder / MARKDOWN, markdown(result, tables))
    page = Template(files("skyherd.bench").joinpath("bench.html").read_text("utf-8")).substitute(
        style=page_style(),
        tiles="\n".join(_tile(value, label) for value, label in _tiles(result)),
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


def _tile(value: str, label: str) -> str:
    return f'<div class="tile"><b>{escape(value)}</b><span>{escape(label)}</span></div>'


def _entry(key: str, value: object) -> str:
    text = "not installed" if value is None else ", ".join(value) if isinstance(value, list) else str(value)
    return f'<tr><th scope="row">{escape(key.replace("_", " "))}</th><td>{escape(text)}</td></tr>'


def _table(table: Table) -> str:
    head = "".join(f'<th scope="col">{escape(cell)}</th>' for cell in table.header)
    body = "\n".join(
        f'<tr><th scope="row">{escape(row[0])}</th>'
        + "".join(f"<td>{escape(cell)}</td>" for cell in row[1:])
        + "</tr>"
        for row in table.rows
    )
    return f"""<section class="measured">
<h3>{escape(table.title)}</h3>
<p class="hint">{escape(table.note)}</p>
<div class="scroll" tabindex="0" role="region" aria-label="{escape(table.title)}">
<table><thead><tr>{head}</tr></thead>
<tbody>
{body}
</tbody></table>
</div>
</section>"""
