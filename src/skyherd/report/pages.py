"""Common base of all pages: template engine and shared page parts.

A page is one HTML file that needs no network or script. Pictures are embedded as data URIs, and so are the
last frames of videos. Videos lie beside the page, or are embedded if the page is to be sent alone. Markup is
in templates only. Every page extends `report/templates/base.html`, which includes the style sheet `page.css`,
and imports the macros of `parts.html`. Packages above this one have a folder `templates/` of their own. The
template engine escapes all inserted text, so that no text of a scenario, a study or a detector's name can
become markup.
"""

from base64 import b64encode
from dataclasses import dataclass
from functools import lru_cache
from io import BytesIO
from pathlib import Path

from jinja2 import ChoiceLoader, Environment, PackageLoader, StrictUndefined
from PIL import Image

from skyherd.files.video_writer import read_last_frame
from skyherd.plots.panels import FigureFile

WIDE_PX = 1000
"""Width above which a figure takes the page's full width, pixels of the PNG. Chosen: default figures of
`skyherd.plots` (936 px) stay in one of two columns, those with several panels do not."""

TALL_RATIO = 0.85
"""Ratio of height to width above which a figure takes two rows of the grid. Chosen: two figures of the usual
ratio, 0.45 to 0.7, with captions are about as high."""


POSTER_QUALITY = 80
"""Quality of a video's poster, per cent of JPEG. Chosen: text of 12 px stays legible."""


@dataclass(frozen=True)
class Tile:
    """A highlighted number on a page: text with unit, and label."""

    value: str
    label: str


@dataclass(frozen=True)
class VideoCard:
    """A video for a page.

    Attributes:
        shape: CSS class: `wide` or `phone`.
        source: name of the video, which lies beside the page, or the video as a data URI.
        poster: its last frame, as a data URI.
    """

    shape: str
    source: str
    poster: str


@dataclass(frozen=True)
class FigureCard:
    """A figure for the macro `figure_grid` of `parts.html`.

    Attributes:
        shape: CSS class of its size: `plain`, `tall` or `wide`.
        name: HTML id, unique in the page.
        title: heading.
        caption: description of the figure.
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
        **values: variables of the template, unescaped. A missing variable raises `jinja2.UndefinedError`; it
            is never an empty string on the page.
    """
    return _environment(package).get_template(template).render(values)


@lru_cache
def _environment(package: str) -> Environment:
    """Return the environment of a package's templates, with the shared templates as fallback."""
    packages = dict.fromkeys((package, "skyherd.report"))
    return Environment(
        loader=ChoiceLoader([PackageLoader(name, "templates") for name in packages]),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )


def figure_card(figure: FigureFile) -> FigureCard:
    """Return a figure on disk as a page card, with its PNG embedded."""
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
    """Return a file as a data URI, such as `data:image/png;base64,…`, for an image or video `src`."""
    return f"data:{media_type};base64,{b64encode(path.read_bytes()).decode('ascii')}"


def video_card(path: Path, shape: str, *, embed: bool) -> VideoCard:
    """Return an MP4 file as a card of a page, with its last frame as the poster.

    Args:
        path: the file.
        shape: CSS class: `wide` or `phone`.
        embed: put the file into the page; it must lie beside the page otherwise.
    """
    picture = BytesIO()
    Image.fromarray(read_last_frame(path)).save(picture, "JPEG", quality=POSTER_QUALITY)
    poster = f"data:image/jpeg;base64,{b64encode(picture.getvalue()).decode('ascii')}"
    return VideoCard(shape, data_uri(path, "video/mp4") if embed else path.name, poster)
