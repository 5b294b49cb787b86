"""The fallback search: it finds markers that the first pass misses, and excludes known markers."""

import cv2
import numpy as np
import pytest

from skyherd.bench.detectors.design import Cell
from skyherd.bench.detectors.frames import rendered_frames
from skyherd.markers.dictionary import marker_cells
from skyherd.vision import PhotometricDetector, create_detector
from skyherd.vision.photometric import detector as stages
from skyherd.vision.search.quads import find_small_quads

DICTIONARY = "APRILTAG_36h11"
SIDE_PX, STEP_PX, ROWS = 11.5, 20.0, 5


def sheet() -> tuple[np.ndarray, np.ndarray]:
    """Return a sharp image of 25 markers with 8 cells of 1.5 px a side, and their centres (25, 2), px."""
    large = 40
    middles = np.array([[u, v] for v in range(ROWS) for u in range(ROWS)]) * STEP_PX + STEP_PX + 4.3
    size = round((ROWS + 1) * STEP_PX) * large
    image = np.full((size, size), 140, np.uint8)
    side = round(SIDE_PX * large)
    for marker_id, (u, v) in enumerate(middles):
        cells = np.where(marker_cells(DICTIONARY, marker_id), 140, 20).astype(np.uint8)
        top, left = (round((at + 0.5) * large) - side // 2 for at in (v, u))
        drawn = cv2.resize(cells, (side, side), interpolation=cv2.INTER_NEAREST)
        image[top : top + side, left : left + side] = drawn
    return cv2.resize(image, None, fx=1 / large, fy=1 / large, interpolation=cv2.INTER_AREA), middles


def near(quads: np.ndarray, middles: np.ndarray) -> np.ndarray:
    """Return the mask (N,) of the centres (N, 2) that have a quadrilateral within 1 px."""
    off = np.linalg.norm(quads.mean(axis=1)[:, None] - middles, axis=2)
    return (off < 1.0).any(axis=0) if len(quads) else np.zeros(len(middles), dtype=bool)


def leave_out_fallback(patch):
    """Let all parts of the fallback search find nothing."""
    for part in ("find_small_quads", "find_faint_quads", "find_crossed_quads"):
        patch.setattr(stages, part, lambda *_: np.zeros((0, 4, 2)))


def test_fallback_search_finds_cells_of_one_and_a_half_pixels(monkeypatch):
    image, middles = sheet()
    assert near(find_small_quads(image, np.zeros((0, 4, 2))), middles).all()
    detector = PhotometricDetector(DICTIONARY, following=False)
    seen = detector.detect(image)
    assert seen.ids.tolist() == list(range(25))
    np.testing.assert_allclose(seen.centers_px, middles, atol=0.1)
    leave_out_fallback(monkeypatch)
    assert len(detector.detect(image)) < len(middles), "without the fallback search"


def test_fallback_search_excludes_known_markers():
    image, middles = sheet()
    half = SIDE_PX / 2
    squares = middles[:, None] + half * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    assert not len(find_small_quads(image, squares))
    but_one = find_small_quads(image, np.delete(squares, 12, axis=0))
    assert near(but_one, middles)[12]


@pytest.mark.parametrize(
    ("cell", "needs_fallback"),
    [
        (Cell(contrast=40.0, blur_px=1.33, cameras=1, frames=2), True),
        (Cell(side_px=40.0, tilt_deg=70.0, blur_px=0.9, cameras=2, frames=1), False),
    ],
    ids=["faint and blurred", "tilted by 70 degrees"],
)
def test_every_marker_that_opencv_finds_is_found(cell, needs_fallback):
    """In rendered images with markers that OpenCV detects. The first pass misses the faint ones."""
    first_alone = 0
    for frame in rendered_frames(cell, "4X4_50", 3):
        theirs = create_detector("opencv").detect(frame.image)
        seen = create_detector().detect(frame.image)
        assert set(theirs.ids) <= set(seen.ids)
        with pytest.MonkeyPatch.context() as patch:
            leave_out_fallback(patch)
            first_alone += len(set(theirs.ids) - set(create_detector().detect(frame.image).ids))
    assert (first_alone > 0) == needs_fallback


class Counted:
    """Numbers of the images with a fallback search."""

    def __init__(self, monkeypatch):
        self.image, self.images = 0, []
        look = stages.find_small_quads

        def counted(*args):
            self.images.append(self.image)
            return look(*args)

        monkeypatch.setattr(stages, "find_small_quads", counted)

    def follow(self, images):
        """Return the set of ids that `tracking` detects in each image."""
        detector, found = create_detector("tracking", dictionary=DICTIONARY), []
        for self.image, image in enumerate(images):
            found.append(set(detector.detect(image, time_s=0.1 * self.image).ids.tolist()))
        return found


def without(image, middle):
    """Return a copy of the image in which the marker at a centre is painted over."""
    left, top = np.round(middle - STEP_PX / 2).astype(int)
    size, covered = round(STEP_PX), image.copy()
    covered[top : top + size, left : left + size] = 140
    return covered


def test_fallback_search_runs_every_tenth_search_if_all_followed(monkeypatch):
    """Every fifth image is searched. In the first image the fallback search finds some of the markers."""
    counted = Counted(monkeypatch)
    image, _ = sheet()
    found = counted.follow([image] * 65)
    assert found == [set(range(25))] * 65
    assert counted.images == [0, 10, 60], "after a success it runs two searches later"


def test_marker_of_fallback_search_is_found_within_50_images(monkeypatch):
    image, middles = sheet()
    with pytest.MonkeyPatch.context() as patch:
        leave_out_fallback(patch)
        seen = create_detector(dictionary=DICTIONARY).detect(image).ids.tolist()
    late = next(number for number in range(25) if number not in seen)
    counted = Counted(monkeypatch)
    found = counted.follow([*[without(image, middles[late])] * 12, *[image] * 50])
    first = next(number for number, ids in enumerate(found) if late in ids)
    assert first == 60 and counted.images == [0, 10, 60]


def test_missing_marker_triggers_both_search_passes(monkeypatch):
    counted = Counted(monkeypatch)
    image, middles = sheet()
    found = counted.follow([*[image] * 13, without(image, middles[7])])
    assert found[-1] == set(range(25)) - {7} and counted.images == [0, 10, 13]


@pytest.mark.parametrize("gap_px", [2, 3, 4])
@pytest.mark.parametrize("width_px", [10, 12])
def test_narrow_square_between_known_ones_is_found(width_px, gap_px) -> None:
    """As of a marker seen at a slant, 28 px high; the known squares themselves are not found again."""
    left = 90 + gap_px
    right = left + width_px + gap_px
    image = np.full((140, 220), 200, np.uint8)
    image[40:90, 40:90] = image[40:90, right : right + 50] = 50
    narrow = np.array([[left, 46.0], [left + width_px, 50], [left + width_px, 78], [left, 74]]) - 0.5
    cv2.fillConvexPoly(image, np.rint(16 * narrow).astype(np.int32), 50, cv2.LINE_AA, 4)
    square = np.array([[0.0, 0], [50, 0], [50, 50], [0, 50]]) - 0.5
    known = square + np.array([[[40.0, 40]], [[right, 40]]])
    middles = find_small_quads(cv2.GaussianBlur(image, (0, 0), 0.8), known).mean(axis=1)
    assert (np.linalg.norm(middles - narrow.mean(axis=0), axis=1) < 1.5).any()
    for middle in known.mean(axis=1):
        assert (np.linalg.norm(middles - middle, axis=1) > 5).all()
