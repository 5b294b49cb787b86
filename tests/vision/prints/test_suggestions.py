"""Suggestions for an image of few detections: markers that are drawn otherwise than those looked for."""

import re

import numpy as np
import pytest

from skyherd.errors import InputError
from skyherd.markers.dictionary import marker_cells, with_border
from skyherd.vision import create_detector
from skyherd.vision.photometric.detector import PhotometricDetector
from skyherd.vision.prints import suggestions
from skyherd.vision.prints.print_evidence import (
    ALL_PRINTS,
    MarkerPrint,
    PrintEvidence,
    PrintSearch,
    _log_evidence,
    _log_ratios,
    _read_squares,
)
from skyherd.vision.prints.suggestions import _likely, find_dictionary, suggest

IDS = [4, 11, 30]


def drawn(ids=IDS, *, dictionary="4X4_50", inverted=False) -> np.ndarray:
    """Markers in a row, 8 px a cell, white on black if inverted."""
    image = np.full((140, 140 * len(ids)), 140, np.uint8)
    for k, marker_id in enumerate(ids):
        cells = np.pad(marker_cells(dictionary, marker_id), 1, constant_values=True)
        card = np.kron(np.where(cells, 230, 30), np.ones((8, 8)))
        half = len(card) // 2
        image[70 - half : 70 + half, 70 + 140 * k - half : 70 + 140 * k + half] = card
    return 255 - image if inverted else image


@pytest.mark.parametrize(
    ("there", "looked_for", "said"),
    [
        ({"inverted": True}, {}, "white on black; try `inverted=True`"),
        ({}, {"inverted": True}, "black on white; try `inverted=False`"),
        (
            {"dictionary": "4X4_50@2"},
            {},
            "drawn with a border of 2 cell(s); try `border_bits=2`",
        ),
        ({}, {"border_bits": 2}, "drawn with a border of 1 cell(s); try `border_bits=1`"),
        (
            {"dictionary": "4X4_50@3", "inverted": True},
            {},
            "white on black and drawn with a border of 3 cell(s); try `inverted=True` `border_bits=3`",
        ),
        (
            {"dictionary": "5X5_50@2"},
            {"border_bits": 2},
            "of another dictionary; try `dictionary=5X5_50`",
        ),
        (
            {"dictionary": "5X5_50", "inverted": True},
            {},
            "white on black and of another dictionary; try `inverted=True` `dictionary=5X5_50`",
        ),
        (
            {"dictionary": "5X5_50", "inverted": True},
            {"inverted": True},
            "of another dictionary; try `dictionary=5X5_50`",
        ),
        (
            {"dictionary": "5X5_50@3", "inverted": True},
            {},
            "white on black, drawn with a border of 3 cell(s) and of another dictionary; "
            "try `inverted=True` `border_bits=3` `dictionary=5X5_50`",
        ),
        (
            {"dictionary": "APRILTAG_36h11"},
            {"border_bits": 2, "inverted": True},
            "black on white, drawn with a border of 1 cell(s) and of another dictionary; "
            "try `border_bits=1` `dictionary=APRILTAG_36h11` `inverted=False`",
        ),
    ],
)
def test_suggestion_names_the_difference_and_finds_the_markers(there, looked_for, said) -> None:
    image = drawn(**there)
    assert suggest(image, "4X4_50", **looked_for) == f"its markers are {said}"
    options = _options(said, looked_for)
    found = create_detector(**options).detect(image).ids
    assert found.tolist() == IDS
    assert create_detector(**{"dictionary": "4X4_50"} | looked_for).detect(image).ids.size < len(IDS)


def _options(said: str, looked_for: dict) -> dict:
    """The options of `create_detector` that a suggestion amounts to."""
    options = {"dictionary": "4X4_50"} | looked_for
    for name, value in re.findall(r"`(\w+)=(\w+)`", said):
        options[name] = {"True": True, "False": False}.get(value, int(value) if value.isdigit() else value)
    return options


@pytest.mark.parametrize("options", [{}, {"inverted": True}])
def test_suggest_returns_none_if_the_settings_are_right(options) -> None:
    image = drawn(inverted=bool(options))
    assert suggest(image, "4X4_50", **options) is None
    assert suggest(drawn([4, 4, 6], inverted=bool(options)), "4X4_50", repeats=True, **options) is None


@pytest.mark.parametrize("options", [{}, {"inverted": True}])
def test_suggest_counts_markers_that_share_their_ids(options) -> None:
    said = suggest(drawn([4, 4, 6], inverted=bool(options)), "4X4_50", **options)
    assert said == "2 markers of 4X4_50 share their ids and are left out; try `repeats=True`"


@pytest.mark.parametrize(
    ("there", "options", "said"),
    [
        ({}, {}, "of another dictionary, and their ids repeat; try `dictionary=5X5_50` `repeats=True`"),
        ({}, {"repeats": True}, "of another dictionary; try `dictionary=5X5_50`"),
        (
            {},
            {"detector": "opencv"},
            "of another dictionary, and their ids repeat; "
            "try `dictionary=5X5_50` `detector=photometric` `repeats=True`",
        ),
        (
            {},
            {"inverted": True},
            "black on white and of another dictionary, and their ids repeat; "
            "try `dictionary=5X5_50` `repeats=True` `inverted=False`",
        ),
        (
            {"dictionary": "5X5_50@2", "inverted": True},
            {},
            "white on black, drawn with a border of 2 cell(s) and of another dictionary, and their ids "
            "repeat; try `inverted=True` `border_bits=2` `dictionary=5X5_50` `repeats=True`",
        ),
    ],
)
def test_suggestion_names_repeats_with_other_options(there, options, said) -> None:
    image = drawn([4, 4, 4], **{"dictionary": "5X5_50"} | there)
    assert suggest(image, "4X4_50", **options) == f"its markers are {said}"


def test_mirrored_markers_that_share_ids_get_one_advice() -> None:
    image = np.ascontiguousarray(drawn([4, 4, 4])[:, ::-1])
    said = suggest(image, "4X4_50") or ""
    assert "3 in its mirror image" in said and said.endswith("; its ids repeat: add `repeats=True`")


def test_larger_dictionary_of_series_is_named_with_inversion() -> None:
    """The named dictionary reads one of three markers, so that its print alone would be half an answer."""
    image = drawn([4, 60, 70], dictionary="4X4_100", inverted=True)
    assert suggest(image, "4X4_50") == (
        "its markers are white on black and of another dictionary; try `inverted=True` `dictionary=4X4_100`"
    )


SMALLEST_WITH_49 = [
    "4X4_50",
    "5X5_50",
    "6X6_50",
    "7X7_50",
    "APRILTAG_36h10",
    "APRILTAG_36h11",
    "ARUCO_MIP_36h12",
]
LARGE = [
    ("5X5_1900", 1899),
    ("6X6_250", 249),
    ("6X6_7900", 7899),
    ("7X7_8000", 7999),
    ("ARUCO_ORIGINAL", 1000),
]


@pytest.mark.parametrize(("name", "last"), [*((name, 49) for name in SMALLEST_WITH_49), *LARGE])
def test_find_dictionary_names_the_smallest_with_all_ids(name, last) -> None:
    assert find_dictionary(drawn([0, 7, last], dictionary=name)) == name


@pytest.mark.parametrize("border_bits", [1, 2, 3])
@pytest.mark.parametrize("seed", range(4))
def test_find_dictionary_reads_noisy_markers_of_every_border(border_bits, seed) -> None:
    """Behind a wide border few cells are white: 3 to 12 of 100 with 16 bits and three cells of border."""
    rng = np.random.default_rng(seed)
    image = drawn(rng.choice(50, 3, replace=False).tolist(), dictionary=with_border("4X4_50", border_bits))
    noisy = np.clip(image + rng.normal(0, 5, image.shape), 0, 255).round().astype(np.uint8)
    assert find_dictionary(noisy, border_bits=border_bits) == "4X4_50"


def test_find_dictionary_counts_the_few_ids_of_a_larger_one() -> None:
    """One id of 21 is beyond 4X4_50. The evidence prefers it for half as many codes."""
    image = drawn([*range(20), 60], dictionary="4X4_100")
    assert PrintSearch(image, [MarkerPrint()]).ranked()[0].dictionary == "4X4_50"
    assert find_dictionary(image) == "4X4_100"


def test_smaller_dictionary_of_the_same_markers_is_not_advised() -> None:
    """It has more evidence, and no more markers."""
    assert suggest(drawn(), "4X4_100") is None


def test_print_with_less_evidence_than_given_is_not_tried(monkeypatch) -> None:
    tried = []
    counted = suggestions.MarkerCount(1, 0)
    for name in ("_count", "_confirm"):
        monkeypatch.setattr(suggestions, name, lambda image, there: tried.append(there[:2]) or counted)
    image = drawn()
    assert len(PrintSearch(image, ALL_PRINTS).ranked()) > 1
    assert suggest(image, "4X4_50") is None and tried == [("4X4_50", MarkerPrint())]


@pytest.mark.parametrize("dictionary", ["5X5_50", "5X5_50@2"])
def test_whole_image_is_searched_once_for_a_suggestion(dictionary, monkeypatch) -> None:
    """Other prints are confirmed at the squares of the evidence: a search takes seconds on large pictures."""
    searched, count = [], suggestions._count
    monkeypatch.setattr(
        suggestions, "_count", lambda image, there: searched.append(there.dictionary) or count(image, there)
    )
    assert suggest(drawn(dictionary=dictionary), "4X4_50") is not None
    assert searched == ["4X4_50"]


@pytest.mark.parametrize("kind", ALL_PRINTS, ids=str)
def test_markers_of_each_print_are_measured_at_its_squares(kind) -> None:
    image = drawn(dictionary=with_border("5X5_50", kind.border_bits), inverted=kind.inverted)
    image = np.ascontiguousarray(image[:, ::-1]) if kind.mirrored else image
    seen, squares_px = PrintSearch(image, ALL_PRINTS).likely_squares(PrintEvidence("5X5_50", kind, 0.0))
    detector = PhotometricDetector(with_border("5X5_50", kind.border_bits), following=False)
    assert detector.measured(seen, squares_px).ids.tolist() == IDS


def test_each_difference_of_a_print_needs_ten_times_the_evidence() -> None:
    plain, other = MarkerPrint(), MarkerPrint(2, inverted=True)
    given = [
        PrintEvidence("5X5_50", other, 5.0),
        PrintEvidence("5X5_50", MarkerPrint(2), 3.0),
        PrintEvidence("5X5_50", plain, 1.0),
        PrintEvidence("4X4_50", plain, -0.1),
    ]
    assert [one.log_evidence for one in _likely(given, plain)] == [1.0, 3.0, 5.0]
    assert [one.log_evidence for one in _likely(given, other)] == [5.0, 3.0, 1.0]


@pytest.mark.parametrize(("light", "squares"), [(0, 1), (3, 1), (4, 0)])
def test_square_with_light_cells_in_its_border_is_not_read(light, squares) -> None:
    cells = np.pad(marker_cells("4X4_50", 4)[1:-1, 1:-1], 1)
    cells[0, 1 : 1 + light] = True
    image = np.kron(np.where(cells, 230, 30), np.ones((8, 8))).astype(np.uint8)
    corners_px = np.array([[[-0.5, -0.5], [47.5, -0.5], [47.5, 47.5], [-0.5, 47.5]]])
    read = _read_squares(image, corners_px, 4, 1)
    assert len(read.bits) == squares
    if squares:
        np.testing.assert_array_equal(read.bits[0].reshape(4, 4) > 0, cells[1:-1, 1:-1])


def test_unknown_dictionary_is_refused_also_without_evidence() -> None:
    with pytest.raises(InputError, match="no dictionary"):
        suggest(np.full((120, 160), 140, np.uint8), "4X4_51")


def test_mirrored_markers_of_other_print_get_one_advice() -> None:
    image = np.ascontiguousarray(drawn(dictionary="6X6_50@2")[:, ::-1])
    assert suggest(image, "4X4_50") == (
        "its markers are mirrored, drawn with a border of 2 cell(s) and of another dictionary; "
        "flip it left to right and try `border_bits=2` `dictionary=6X6_50`"
    )


def test_evidence_of_random_bits_obeys_its_bound() -> None:
    """At most `exp(-E)` of images without markers have evidence E; one marker in ten squares has more."""
    rng, codes, bits = np.random.default_rng(5), 200, 16
    patterns = rng.integers(0, 2, (codes, bits))
    products = []
    for _ in range(4000):
        squares = rng.integers(0, 2, (30, bits))
        wrong = (squares[:, None] != patterns).sum(axis=2).min(axis=1)
        products.append(np.exp(_log_evidence(_log_ratios(wrong, bits, codes), np.arange(30) // 3)))
    assert np.mean(products) <= 1 + 3 * np.std(products) / np.sqrt(len(products))
    for least in (1.0, 2.0, 3.0):
        assert np.mean(np.log(products) >= least) <= np.exp(-least)
    wrong = wrong[:10]
    wrong[0] = 0
    assert _log_evidence(_log_ratios(wrong, bits, codes), np.arange(10)) > 0
    assert _log_evidence(np.full(10, np.log(1e6)), np.arange(10)) > 100


def test_squares_of_one_place_count_once() -> None:
    ratios = np.array([5.0, 5.0, 5.0])
    one, three = (_log_evidence(ratios, np.array(places)) for places in ([0, 0, 0], [0, 1, 2]))
    assert one == pytest.approx(_log_evidence(ratios[:1], np.array([0])))
    assert three > one + 5


def test_blank_image_has_no_evidence() -> None:
    assert PrintSearch(np.full((120, 160), 140, np.uint8), ALL_PRINTS).ranked() == []


def test_nothing_is_suggested_for_an_image_of_nothing() -> None:
    assert suggest(np.full((120, 160), 140, np.uint8), "4X4_50") is None


@pytest.mark.parametrize("border_bits", [1, 2])
def test_a_dictionary_is_found_in_the_print_that_is_told(border_bits) -> None:
    name = "5X5_50" + ("@2" if border_bits == 2 else "")
    image = drawn(dictionary=name, inverted=True)
    assert find_dictionary(image, border_bits=border_bits, inverted=True) == "5X5_50"
    assert find_dictionary(drawn(dictionary=name), border_bits=border_bits) == "5X5_50"


def test_a_border_that_cannot_be_is_refused() -> None:
    with pytest.raises(InputError, match="border bits: 4"):
        suggest(drawn(), "4X4_50", border_bits=4)
