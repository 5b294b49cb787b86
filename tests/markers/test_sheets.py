"""Marker sheets: parsed from the PDF's drawing commands, and detected in a raster of the pages."""

import io
import re
import zlib

import numpy as np
import pytest
from PIL import Image

from skyherd.cli import main
from skyherd.errors import InputError
from skyherd.markers.dictionary import card_side
from skyherd.markers.sheet_layout import PAPERS_MM, lay_out, max_side_mm, parse_ids, parse_length_mm
from skyherd.markers.sheets import draw_pages, write_sheets
from skyherd.vision import create_detector

POINTS_PER_MM = 72 / 25.4
ROUNDING_MM = 2e-6 / POINTS_PER_MM
"""Tolerance of sides, mm: coordinates have six decimals of a point, and a side is a difference of two."""


def pages_of(pdf: bytes) -> list[str]:
    """Return the drawing commands of each page."""
    streams = [
        zlib.decompress(data) for data in re.findall(rb"stream\r?\n(x.*?)\r?\nendstream", pdf, re.DOTALL)
    ]
    return [text.decode("latin-1") for text in streams if b" m\n" in text and b"BT" in text]


def squares_mm(page: str, side_mm: float) -> np.ndarray:
    """Return the lower left corners (N, 2), mm, of the filled squares of that side."""
    path = r"([\d.]+) ([\d.]+) m\n([\d.]+) ([\d.]+) l\n([\d.]+) ([\d.]+) l\n([\d.]+) ([\d.]+) l\nh\s+f"
    corners = np.array([[float(x) for x in found] for found in re.findall(path, page)]).reshape(-1, 4, 2)
    corners /= POINTS_PER_MM
    extent = np.ptp(corners, axis=1)
    return corners.min(axis=1)[np.abs(extent - side_mm).max(axis=1) < 10 * ROUNDING_MM]


@pytest.mark.parametrize(
    ("paper", "side_mm", "count"), [("A4", 120.0, 3), ("A5", 40.0, 7), ("Letter", 90.0, 3)]
)
def test_pdf_squares_have_side_and_position(tmp_path, paper, side_mm, count) -> None:
    layout = write_sheets(tmp_path / "sheets.pdf", range(count), side_mm, "4X4_50", paper)
    data = (tmp_path / "sheets.pdf").read_bytes()
    boxes = re.findall(rb"/MediaBox \[ ?0 0 ([\d.]+) ([\d.]+) ?\]", data)
    assert len(boxes) == -(-count // layout.per_page)
    for box in boxes:
        size_mm = np.array([float(x) for x in box]) / POINTS_PER_MM
        np.testing.assert_allclose(sorted(size_mm), PAPERS_MM[paper], atol=1e-4)
    found = np.concatenate([squares_mm(page, side_mm) for page in pages_of(data)])
    quiet = (layout.card_mm - side_mm) / 2
    wanted = np.array([layout.corner_mm(k % layout.per_page) for k in range(count)]) + quiet
    np.testing.assert_allclose(found, wanted, atol=1e-4)


def test_pdf_reading_rejects_other_side(tmp_path) -> None:
    """Negative control of the parser: a side of 0.1 mm more is not found."""
    write_sheets(tmp_path / "sheets.pdf", [3], 40.0, "4X4_50", "A4")
    page = pages_of((tmp_path / "sheets.pdf").read_bytes())[0]
    assert len(squares_mm(page, 40.0)) == 1 and len(squares_mm(page, 40.1)) == 0


@pytest.mark.parametrize(
    "dictionary", ["4X4_50", "6X6_1900", pytest.param("APRILTAG_36h11", marks=pytest.mark.slow)]
)
def test_pages_are_detected_at_true_size_heading_up(dictionary: str) -> None:
    """At 254 dpi, ten dots per mm: edges are rounded to dots, so that sides are right to one."""
    ids = [0, 7, 15, 300][: 3 if dictionary == "4X4_50" else 4]
    layout = lay_out("A5", 50.0, dictionary)
    found = []
    for figure in draw_pages(ids, layout, dictionary):
        file = io.BytesIO()
        figure.savefig(file, dpi=254, format="png")
        seen = create_detector(dictionary=dictionary).detect(np.asarray(Image.open(file).convert("L")))
        np.testing.assert_allclose(seen.sides_px, 500, atol=2.0)
        np.testing.assert_allclose(np.degrees(seen.headings_rad), -90, atol=0.3)
        found += seen.ids.tolist()
    assert sorted(found) == ids


@pytest.mark.parametrize("paper", PAPERS_MM)
@pytest.mark.parametrize("dictionary", ["4X4_50", "7X7_8000"])
def test_max_side_fits_and_one_mm_more_does_not(paper: str, dictionary: str) -> None:
    side_mm = max_side_mm(paper, dictionary)
    layout = lay_out(paper, side_mm, dictionary)
    x, y = layout.corner_mm(0)
    assert layout.per_page >= 1 and min(x, y) > 0
    assert x + layout.card_mm < layout.page_mm[0]
    with pytest.raises(InputError, match=f"at most {side_mm:g} mm do"):
        lay_out(paper, side_mm + 1, dictionary)


@pytest.mark.parametrize("side_mm", [15.0, 33.0, 80.0])
def test_cards_stay_apart_and_on_page(side_mm: float) -> None:
    layout = lay_out("A3", side_mm, "5X5_100")
    corners = np.array([layout.corner_mm(k) for k in range(layout.per_page)])
    assert corners.min() > 8 and (corners.max(axis=0) + layout.card_mm + 8 <= layout.page_mm).all()
    assert layout.card_mm == pytest.approx(side_mm * card_side("5X5_100"))
    apart = np.abs(corners[:, None] - corners[None]).max(axis=2) + np.eye(len(corners)) * 1e3
    assert apart.min() >= layout.card_mm + 8 - 1e-9


@pytest.mark.smoke
def test_ids_and_lengths_are_parsed() -> None:
    assert parse_ids("0-3, 20,2", "4X4_50") == [0, 1, 2, 3, 20]
    assert [parse_length_mm(text, "side") for text in ("0.12m", "12 cm", "120mm", ".5cm")] == [
        120,
        120,
        120,
        5,
    ]


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--ids", "0", "--side", "0.3m"], ["do not fit A4", "at most 145 mm", "A2 holds 300 mm"]),
        (["--ids", "0-50", "--side", "3cm"], ["50 is not in 4X4_50", "0 to 49"]),
        (["--ids", "5-1", "--side", "3cm"], ["backwards", "1-5"]),
        (["--ids", "a", "--side", "3cm"], ["'a'", "0-15,20"]),
        (["--ids", "0", "--side", "3"], ["'3'", "0.12m"]),
        (["--ids", "0", "--side", "0mm"], ["'0mm'", "positive"]),
        (["--ids", "0", "--side", "3cm", "--paper", "B4"], ["'B4'", "Letter"]),
        (["--ids", "0", "--side", "3cm", "--dictionary", "X"], ["'X'", "4X4_50", "7X7_8000"]),
        (["--ids", "0", "--side", "3cm", "--out", "a.png"], ["a.png", ".pdf"]),
        (["--ids", "0", "--side", "3cm", "--out", "no/a.pdf"], ["no/a.pdf", "no folder no"]),
    ],
)
def test_impossible_sheet_is_rejected_and_leaves_nothing(
    tmp_path, monkeypatch, capsys, arguments, words
) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SystemExit) as left:
        main(["markers", "--out", "a.pdf", *arguments])
    message = capsys.readouterr().err
    assert left.value.code == 2 and message.count("\n") == 1 and all(word in message for word in words), (
        message
    )
    assert not list(tmp_path.iterdir())


def test_sheet_is_reproducible(tmp_path, capsys) -> None:
    for name in ("a.pdf", "b.pdf"):
        with pytest.raises(SystemExit) as left:
            main(["markers", "--ids", "0-3", "--side", "3cm", "--paper", "a4", "--out", str(tmp_path / name)])
        assert left.value.code == 0
    assert (tmp_path / "a.pdf").read_bytes() == (tmp_path / "b.pdf").read_bytes()
    with pytest.raises(SystemExit) as left:
        main(["markers", "--ids", "0", "--side", "3cm", "--out", str(tmp_path / "a.pdf")])
    assert left.value.code == 2 and "--force" in capsys.readouterr().err
