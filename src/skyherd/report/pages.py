"""What all pages share: the template engine, and the parts that more than one page shows.

A page is one HTML file that needs no other file, no network and no script: pictures and videos are inside it
as data URIs. Markup is in templates alone. Every page extends `report/templates/base.html`, which has the
style sheet `page.css` in it, and imports the macros of `parts.html`; packages above this one have a folder
`templates/` of their own. The template engine escapes whatever is inserted, so that no text of a scenario, a
study or a detector's name can become markup.
"""

from base64 import b64encode
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

from jinja2 import ChoiceLoader, Environment, PackageLoader, StrictUndefined
from PIL import Image

from skyherd.plots.panels import FigureFile

WIDE_PX = 1000
"""Figures wider than this, in pixels of the PNG, take the page's full width. Chosen: figures of the width
that `skyherd.plots` draws by default (936 px) stay in one of the two columns, those with several panels do
not."""

TALL_RATIO = 0.85
"""Figures whose height over width is greater than this take two rows of the grid of figures. Chosen: two
figures of the usual ratio, 0.45 to 0.7, with their captions are about as high."""


@dataclass(frozen=True)
class Tile:
    """A number that stands out on a page, as text with its unit, and what it is."""

    value: str
    label: str


@dataclass(frozen=True)
class FigureCard:
    """A figure as the macro `figure_grid` of `parts.html` shows it.

    Attributes:
        shape: CSS class that says how much room it takes: `plain`, `tall` or `wide`.
        name: HTML id, unique in the page.
        title: heading.
        caption: what the figure shows.
        source: the picture, as a data URI.
        width_px: width of the picture.
        height_px: height of the picture.
    """

    shape: str
    name: str
    title: str
    caption: str
    source: str
    width_px: int
    height_px: int


def render_page(package: str, template: str, **values: object) -> str:
    """Fill in a template, and return the whole page as HTML.

    Args:
        package: Python package whose folder `templates/` has the template.
        template: file name of the template.
        **values: what the template refers to, unescaped. A value that the template needs and that is not
            given raises `jinja2.UndefinedError`; it is never an empty string on the page.
    """
    return _environment(package).get_template(template).render(values)


@lru_cache
def _environment(package: str) -> Environment:
    """Templates of a package, read as package resources, and below them those that all pages share."""
    packages = dict.fromkeys((package, "skyherd.report"))
    return Environment(
        loader=ChoiceLoader([PackageLoader(name, "templates") for name in packages]),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )


def figure_card(figure: FigureFile) -> FigureCard:
    """A figure on disk as a card of a page, its PNG embedded."""
    with Image.open(figure.png) as image:
        width, height = image.size
    return FigureCard(
        shape="wide" if width > WIDE_PX else "tall" if height > TALL_RATIO * width else "plain",
        name=figure.name,
        title=figure.title,
        caption=figure.caption,
        source=data_uri(figure.png, "image/png"),
        width_px=width,
        height_px=height,
    )


def data_uri(path: Path, media_type: str) -> str:
    """A file's bytes as a data URI, such as `data:image/png;base64,…`, for the `src` of an image or video."""
    return f"data:{media_type};base64,{b64encode(path.read_bytes()).decode('ascii')}"
