"""Page of the report, as text and in a browser."""

import dataclasses
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from html.parser import HTMLParser
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
import pytest

from skyherd.analysis.history import History, make_history
from skyherd.analysis.summary import summarize
from skyherd.analysis.summary_fields import GROUPS, TREE, Field, number_text, value_text
from skyherd.datasets import load_mission
from skyherd.errors import OutputError
from skyherd.files.video_writer import VideoSink
from skyherd.loop import run_steps
from skyherd.plots import panels
from skyherd.plots.panels import PANELS, Panel, write_figures
from skyherd.report.run_page import PAPER, _status, write_page

WIDTHS = {"desktop": (1280, 900), "phone": (390, 844)}
FEW = tuple(panel for panel in PANELS if panel.name in {"paths", "cost", "topology"})
"""One figure of each kind suffices to test the page; slow tests use all."""

VERSIONS = MappingProxyType({"skyherd": "0.1.0", "numpy": np.__version__})


@pytest.fixture(scope="module")
def history() -> History:
    mission = load_mission("star", ["duration_s=3.0", "perception='ideal'"])
    return make_history(mission, run_steps(mission))


def write_video(path: Path) -> None:
    """Write a video of two seconds, from dark to bright."""
    with VideoSink(path, (160, 120), 10) as sink:
        for grey in np.linspace(0, 255, 20).astype(np.uint8):
            sink.write(np.full((120, 160, 3), grey))


@pytest.fixture(
    scope="module", params=[FEW, pytest.param(PANELS, marks=pytest.mark.slow)], ids=["few", "all"]
)
def on_page(request: pytest.FixtureRequest) -> tuple[Panel, ...]:
    return request.param


@pytest.fixture(scope="module")
def page(history: History, on_page: tuple[Panel, ...], tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("run")
    write_video(folder / "video.mp4")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(panels, "PANELS", on_page)
        figures = write_figures(history, folder / "figures")
    return write_page(
        folder, history, summarize(history, 1.5), figures, VERSIONS, "[scenario]\n" + "x = 1 " * 80
    )


class Outline(HTMLParser):
    """Tags in document order; checks that each is closed in the right place."""

    VOID = frozenset({"meta", "link", "img", "br"})

    def __init__(self, text: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.feed(text)
        self.close()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))
        if tag not in self.VOID:
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def all(self, tag: str) -> list[dict[str, str | None]]:
        return [attributes for name, attributes in self.tags if name == tag]


def test_page_loads_only_the_video_beside_it(page: Path, on_page: tuple[Panel, ...]) -> None:
    text = page.read_text("utf-8")
    outline = Outline(text)
    assert text.startswith("<!DOCTYPE html>")
    assert not outline.open
    assert not outline.all("script")
    assert outline.all("html") == [{"lang": "en"}]
    assert len(outline.all("video")) == 1
    assert len(outline.all("img")) == len(on_page)
    assert all(image["alt"] for image in outline.all("img"))
    loaded = [(tag, a[key] or "") for tag, a in outline.tags for key in ("src", "href", "poster") if key in a]
    beside = [(tag, source) for tag, source in loaded if tag != "a" and not source.startswith("data:")]
    assert beside == [("video", "video.mp4")]
    assert [source for tag, source in loaded if tag == "a"] == [PAPER]
    assert outline.all("video")[0]["poster"].startswith("data:image/jpeg;base64,")
    ids = [a["id"] for _, a in outline.tags if "id" in a]
    assert len(ids) == len(set(ids))


def test_page_describes_the_video_only_if_there_is_one(page: Path, history: History, tmp_path: Path) -> None:
    without = write_page(tmp_path, history, summarize(history, 1.5), [], VERSIONS, "").read_text("utf-8")
    end = "The figures below show the run over time.</p>"
    said = "The video shows the images, the ground from above, and the cost and the scales over time."
    assert f"the method</a>). {said} {end}" in page.read_text("utf-8")
    assert f"the method</a>). {end}" in without and "video" not in without.partition("<body")[2].lower()


@pytest.mark.smoke
def test_page_shows_every_summary_value(page: Path, history: History) -> None:
    text = page.read_text("utf-8")
    summary = summarize(history, 1.5)
    fields = {field.key: field for name, group in GROUPS.items() if name != TREE for field in group}
    assert set(summary) == set(fields) | {"final_positions_m"}
    for key, field in fields.items():
        assert f"{field.label}</th><td>{value_text(field, summary[key])}</td>" in text
    for x_m, y_m in summary["final_positions_m"].values():
        assert f"({x_m:.3f}, {y_m:.3f}) m" in text


def test_inserted_text_is_escaped(history: History, tmp_path: Path) -> None:
    hostile = "<script>alert('$x')</script>&"
    summary = {**summarize(history, 1.5), "scenario": hostile, hostile: hostile}
    scenario = history.mission.scenario.model_copy(update={"name": hostile, "description": hostile})
    renamed = replace(history, mission=replace(history.mission, scenario=scenario))
    text = write_page(tmp_path, renamed, summary, [], {hostile: hostile}, hostile).read_text("utf-8")
    assert "<script" not in text
    assert not Outline(text).open
    assert "$x" in text


@pytest.mark.parametrize("flaws", ["", "cut short after 3 s", "damaged chunk"])
def test_status_is_the_verdict(flaws: str, history: History, tmp_path: Path) -> None:
    summary = {**summarize(history, None), "recording": flaws}
    words = f"The recording is not intact ({flaws}). Cut short" if "damaged" in flaws else ">Cut short"
    text = write_page(tmp_path, history, summary, [], VERSIONS, "").read_text("utf-8")
    assert words in text
    assert "<video" not in text
    assert "not known" in text


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (0, "0"), (0.0, "0"), (12345, "12345"), (0.0123456, "0.01235"), (99999.6, "1 × 10⁵"),
        (1.88668e-8, "1.887 × 10⁻⁸"), (-2.5e12, "−2.5 × 10¹²"), (999.96, "1000"),
    ],
)  # fmt: skip
def test_number_text_format(value: float, text: str) -> None:
    assert number_text(value) == text


@pytest.mark.parametrize(
    ("field", "value", "text"),
    [
        (Field("x", "x", "m"), None, "not known"),
        (Field("x", "x", "m"), float("nan"), "not known"),
        (Field("x", "x", absent="no change"), None, "no change"),
        (Field("x", "x", absent="no change"), float("nan"), "not known"),
        (Field("x", "x"), True, "yes"),
        (Field("x", "x", "m²"), 2.5, "2.5 m²"),
        (Field("x", "x", kind="angle"), -np.pi / 2, "−90.0° (−1.571 rad)"),
        (Field("x", "x", kind="share"), 0.99995, "99.995 %"),
        (Field("x", "x", kind="error"), 0.0041406, "0.414 %"),
        (Field("x", "x"), [1, 2], "[1, 2]"),
        (Field("x", "x", "", "", "ids"), [1, 2], "1, 2"),
        (Field("x", "x", "", "", "ids"), [], "none"),
    ],
)
def test_value_text_format(field: Field, value: object, text: str) -> None:
    assert value_text(field, value) == text


def test_unwritable_page_is_named(history: History, tmp_path: Path) -> None:
    (tmp_path / "report.html").mkdir()
    with pytest.raises(OutputError, match=r"report\.html: cannot be written"):
        write_page(tmp_path, history, summarize(history, None), [], VERSIONS, "")
    assert [path.name for path in tmp_path.iterdir()] == ["report.html"]


@dataclass
class Window:
    """The page in a browser window, with its requests and console messages so far."""

    page: Any
    requests: list[str] = dataclasses.field(default_factory=list)
    complaints: list[str] = dataclasses.field(default_factory=list)


@pytest.fixture(
    scope="module", params=[(w, scheme) for w in WIDTHS for scheme in ("light", "dark")], ids="-".join
)
def window(browser: Any, page: Path, request: pytest.FixtureRequest) -> Iterator[Window]:
    """Load the page once for all tests: loading takes most of their time."""
    width, scheme = request.param
    size = dict(zip(("width", "height"), WIDTHS[width], strict=True))
    opened = Window(browser.new_page(viewport=size, color_scheme=scheme))
    opened.page.on("console", lambda message: opened.complaints.append(f"{message.type}: {message.text}"))
    opened.page.on("pageerror", lambda error: opened.complaints.append(str(error)))
    opened.page.on("request", lambda asked: opened.requests.append(asked.url))
    opened.page.goto(page.as_uri(), wait_until="load")
    yield opened
    opened.page.close()


OPENED = "[...document.querySelectorAll('details')].map(e => e.open)"
CLOSE = "open => document.querySelectorAll('details').forEach((e, k) => { e.open = open[k] })"


@pytest.fixture
def shown(window: Window, page: Path) -> Iterator[Any]:
    """Return the page in a clean window, and check that it makes no request and logs no error."""
    before = window.page.evaluate(OPENED)
    yield window.page
    window.page.evaluate(CLOSE, before)
    assert not window.complaints
    assert page.as_uri() in window.requests
    assert [url[:80] for url in window.requests if not url.startswith(("file:", "data:"))] == []


COLORS = """place => {
  const element = document.querySelector(place);
  let ground = element;
  while (getComputedStyle(ground).backgroundColor === 'rgba(0, 0, 0, 0)') ground = ground.parentElement;
  return [getComputedStyle(element).color, getComputedStyle(ground).backgroundColor]
    .map(color => color.match(/[0-9]+/g).slice(0, 3).map(Number));
}"""


def test_page_fits_window(shown: Any, assert_nothing_overflows: Callable[[Any], None]) -> None:
    assert_nothing_overflows(shown)
    shown.evaluate("document.querySelectorAll('details').forEach(e => { e.open = true })")
    assert_nothing_overflows(shown)


def test_every_image_is_decoded(shown: Any, on_page: tuple[Panel, ...]) -> None:
    widths = shown.evaluate(
        "Promise.all([...document.images].map(async e => { await e.decode(); return e.naturalWidth }))"
    )
    assert len(widths) == len(on_page)
    assert min(widths) > 0


def test_video_plays_to_end(shown: Any) -> None:
    shown.evaluate("(v => { v.playbackRate = 16; return v.play() })(document.querySelector('video'))")
    shown.wait_for_function("document.querySelector('video').ended", timeout=10_000)
    state = shown.evaluate(
        "(({error, duration, videoWidth}) => ({error, duration, videoWidth}))"
        "(document.querySelector('video'))"
    )
    assert state == {"error": None, "duration": pytest.approx(2.0, abs=0.05), "videoWidth": 160}


def test_figure_opens_in_full_width(shown: Any) -> None:
    card = shown.locator("#cost")
    before = card.bounding_box()["width"]
    card.locator("summary").click()
    image = card.locator("img").bounding_box()["width"]
    assert image >= 700
    assert card.bounding_box()["width"] >= before
    card.locator("summary").click()
    assert card.bounding_box()["width"] == before


def test_text_contrast_meets_wcag(shown: Any) -> None:
    """WCAG 2: contrast of at least 4.5 to 1 for all text styles of the page."""
    places = ["body", ".lead", ".status", ".tile b", ".tile span", "figcaption p", "td + td", "footer"]
    for text, ground in (shown.evaluate(COLORS, place) for place in places):
        light, dark = sorted((luminance(text), luminance(ground)), reverse=True)
        assert (light + 0.05) / (dark + 0.05) >= 4.5


def luminance(rgb: list[int]) -> float:
    """Return the relative luminance of an 8-bit sRGB colour (WCAG 2)."""
    share = np.array(rgb) / 255
    linear = np.where(share <= 0.04045, share / 12.92, ((share + 0.055) / 1.055) ** 2.4)
    return float(linear @ [0.2126, 0.7152, 0.0722])


def test_number_and_per_cent_sign_of_the_status_stay_together() -> None:
    """A phone breaks the line at the last space."""
    assert (
        _status({"verdict": "reached, with an error of 0.1 %."}).split(" ")[-1] == "0.1\N{NO-BREAK SPACE}%."
    )
