"""Generated dictionaries: distances by brute force over every pair, rotation and mirror image."""

import cv2
import numpy as np
import pytest

from skyherd.errors import InputError
from skyherd.markers.codes import CODES, MarkerCode, code_bits, span
from skyherd.markers.dictionary import (
    cells_per_side,
    dictionary_names,
    dictionary_size,
    load_dictionary,
    marker_cells,
)
from skyherd.vision import create_detector, explain_mirrored

FROZEN = [
    ("5X5_1900", 0x554AAB, 0xBFBFE),
    ("6X6_1900", 0x256852A76, 0xF3CC3974),
    ("6X6_7900", 0x8EC56A56, 0x3E4FFDFDF),
    ("7X7_8000", 0x2A9096BAAAE8, 0xE1C58F5EDF2),
]

SOME = [pytest.param(name, marks=pytest.mark.slow if name.startswith("6X6") else ()) for name in CODES]
"""Smallest and largest dictionary. `FROZEN` covers all; slow tests include those of 6x6 bits."""


def images_of(bits: np.ndarray, mirrored: bool) -> list[np.ndarray]:
    """Return four quarter turns (N, n²), as -1 and 1."""
    side = bits[:, :, ::-1] if mirrored else bits
    return [np.rot90(side, k, (1, 2)).reshape(len(bits), -1) * np.float32(2) - 1 for k in range(4)]


def min_distance(bits: np.ndarray, *, mirrored: bool, every: int = 1) -> int:
    """Return the least distance of every `step`-th marker to all in all turns, except to itself."""
    n = bits[0].size
    chosen = np.arange(0, len(bits), every)
    own, least = images_of(bits, False)[0], n
    for turn, other in enumerate(images_of(bits, mirrored)):
        for rows in np.split(chosen, range(1000, len(chosen), 1000)):
            distance = (n - own[rows] @ other.T) / 2
            if turn == 0 and not mirrored:
                distance[np.arange(len(rows)), rows] = n
            least = min(least, int(distance.min()))
    return least


@pytest.mark.parametrize("every", [7, pytest.param(1, marks=pytest.mark.slow)])
@pytest.mark.parametrize("name", SOME)
def test_markers_keep_distance_under_all_symmetries(name: str, every: int) -> None:
    code = CODES[name]
    bits = code_bits(code)
    assert bits.shape == (code.size, code.cells, code.cells)
    assert min_distance(bits, mirrored=False, every=every) == code.distance
    assert min_distance(bits, mirrored=True, every=every) >= code.distance


def test_distance_check_detects_rotated_copy() -> None:
    """Negative control: OpenCV's 6X6_1000 has mirror images, and a copy has distance 0."""
    bits = code_bits(CODES["6X6_1900"])[:50]
    copied = np.concatenate([bits, np.rot90(bits[7:8], 1, (1, 2))])
    assert min_distance(copied, mirrored=False) == 0
    theirs = np.stack([marker_cells("6X6_1000", k)[1:-1, 1:-1] for k in range(1000)])
    assert min_distance(theirs, mirrored=False) == 9
    assert min_distance(theirs, mirrored=True) == 0


@pytest.mark.parametrize(("name", "first", "last"), FROZEN)
def test_ids_are_frozen(name: str, first: int, last: int) -> None:
    """Printed markers outlive versions: first and last word of each dictionary, hexadecimal."""
    words = [int("".join(str(int(b)) for b in bits.ravel()), 2) for bits in code_bits(CODES[name])[[0, -1]]]
    assert words == [first, last]


def test_span_is_closed_under_exclusive_or() -> None:
    words = span((0b0011, 0b0101, 0b1000))
    assert np.unique(words).size == 8
    assert np.isin(words[:, None] ^ words[None, :], words).all()


def test_names_are_new_and_listed() -> None:
    theirs = {name.removeprefix("DICT_") for name in dir(cv2.aruco) if name.startswith("DICT_")}
    assert not theirs & set(CODES)
    names = dictionary_names()
    assert set(names) <= theirs | set(CODES)
    folded = [name.upper() for name in names]
    assert set(folded) == {name.upper() for name in theirs | set(CODES)} and len(set(folded)) == len(folded)
    assert "APRILTAG_36h11" in names and "APRILTAG_36H11" not in names
    with pytest.raises(InputError, match=r"no dictionary '6X6_4001'.*6X6_7900"):
        load_dictionary("6X6_4001")


@pytest.mark.parametrize("name", CODES)
def test_opencv_corrects_half_the_distance(name: str) -> None:
    dictionary, code = load_dictionary(name), CODES[name]
    assert isinstance(code, MarkerCode)
    assert dictionary_size(name) == code.size and cells_per_side(name) == code.cells + 2
    assert dictionary.maxCorrectionBits == (code.distance - 1) // 2
    np.testing.assert_array_equal(marker_cells(name, code.size - 1)[1:-1, 1:-1], code_bits(code)[-1])
    with pytest.raises(InputError, match=f"0 to {code.size - 1}"):
        marker_cells(name, code.size)


def sheet_of(name: str, ids: list[int]) -> np.ndarray:
    """Draw markers of 60 px side by side, each turned once more than the previous one."""
    n = cells_per_side(name)
    image = np.full((100, 100 * len(ids)), 255, np.uint8)
    for k, marker_id in enumerate(ids):
        marker = np.where(marker_cells(name, marker_id), 255, 0).astype(np.uint8)
        marker = cv2.resize(np.rot90(marker, k).copy(), (60, 60), interpolation=cv2.INTER_NEAREST)
        image[20:80, 100 * k + 20 : 100 * k + 80] = marker
    assert n * 6 <= 60
    return image


@pytest.mark.parametrize("name", SOME)
def test_drawn_markers_are_detected_unless_mirrored(name: str) -> None:
    ids = [0, 1, CODES[name].size // 2, CODES[name].size - 1]
    image = sheet_of(name, ids)
    mirrored = np.ascontiguousarray(image[:, ::-1])
    for detector in ("opencv", "photometric"):
        seen = create_detector(detector, dictionary=name).detect(image)
        assert seen.ids.tolist() == ids
        turns = np.angle(np.exp(1j * (seen.headings_rad + np.pi / 2 * (1 + np.arange(4)))))
        np.testing.assert_allclose(turns, 0, atol=0.02)
        assert len(create_detector(detector, dictionary=name).detect(mirrored)) == 0
    assert "mirrored" in (explain_mirrored(mirrored, name) or "")


def test_apriltag_36h11_has_published_order_and_orientation() -> None:
    """Ids 0, 1 and 2 of the tag family's published codes, 0xd5d628584, 0xd97f18b49, 0xdd280910e.

    AprilTag lists the first releases' codes row by row from the tag's upper left corner. OpenCV stores the
    tag rotated by 180 degrees, which changes headings, not ids.
    """
    for marker_id, code in enumerate((0xD5D628584, 0xD97F18B49, 0xDD280910E)):
        published = np.array([code >> k & 1 for k in range(35, -1, -1)], dtype=bool).reshape(6, 6)
        ours = marker_cells("APRILTAG_36h11", marker_id)[1:-1, 1:-1]
        same = [turn for turn in range(4) if (np.rot90(published, turn) == ours).all()]
        assert same == [2]
