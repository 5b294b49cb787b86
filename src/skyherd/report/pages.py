"""What all pages share: one HTML file each, that needs no other file, no network and no script."""

from base64 import b64encode
from collections.abc import Sequence
from html import escape
from importlib.resources import files
from pathlib import Path
from string import Template

from PIL import Image

from skyherd.plots.panels import FigureFile

WIDE_PX = 1000
"""Figures wider than this take the page's full width."""

TALL = 0.85
"""Figures of a greater height over width take the place of two below each other."""


def html_page(package: str, name: str, title: str, /, **parts: str) -> str:
    """A page: a package's template `name`.html, its parts filled in, in the shell that all pages have."""
    body = _template(package, f"{name}.html").substitute(parts)
    style = _template("skyherd.report", "page.css").template
    return _template("skyherd.report", "page.html").substitute(title=escape(title), style=style, body=body)


def _template(package: str, name: str) -> Template:
    return Template(files(package).joinpath("templates", name).read_text("utf-8"))


def tile(value: str, label: str) -> str:
    """A number that stands out, and what it is."""
    return f'<div class="tile"><b>{escape(value)}</b><span>{escape(label)}</span></div>'


def wide_table(label: str, head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A table that scrolls where the page is narrow; the first cell of a row is its head."""
    top = "".join(f'<th scope="col">{escape(cell)}</th>' for cell in head)
    body = "\n".join(
        f'<tr><th scope="row">{escape(row[0])}</th>'
        + "".join(f"<td>{escape(cell)}</td>" for cell in row[1:])
        + "</tr>"
        for row in rows
    )
    return f"""<div class="scroll" tabindex="0" role="region" aria-label="{escape(label)}">
<table><thead><tr>{top}</tr></thead>
<tbody>
{body}
</tbody></table>
</div>"""


def figure_card(figure: FigureFile) -> str:
    """A figure as HTML, its picture inside, that opens in full width."""
    with Image.open(figure.png) as image:
        width, height = image.size
    shape = "wide" if width > WIDE_PX else "tall" if height > TALL * width else "plain"
    title, caption = escape(figure.title), escape(figure.caption)
    return f"""<figure class="{shape}" id="{escape(figure.name)}">
<details><summary><img src="{data_uri(figure.png, "image/png")}" alt="{title}: {caption}" \
width="{width}" height="{height}"></summary></details>
<figcaption><h3>{title}</h3><p>{caption}</p></figcaption>
</figure>"""


def data_uri(path: Path, kind: str) -> str:
    """A file's bytes, as what a page can hold."""
    return f"data:{kind};base64,{b64encode(path.read_bytes()).decode('ascii')}"
