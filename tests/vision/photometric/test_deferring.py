"""Deferred searches: detection does not wait for them, and they find what an immediate search finds."""

import numpy as np
import pytest

from skyherd.errors import InputError
from skyherd.vision import DeferringDetector, PhotometricDetector, create_detector
from skyherd.vision.photometric import detector as deferring
from skyherd.vision.photometric.detector import LOOK_AROUND_INTERVAL, SEARCH_INTERVAL

DICTIONARY, SIZE = "4X4_50", (400, 320)
HOMES = np.array([80 + 80j, 200 + 80j, 320 + 80j, 80 + 230j, 200 + 230j, 320 + 230j])
IDS = np.array([3, 8, 21, 30, 34, 45])
COMES, LATEST = 2, 2 + LOOK_AROUND_INTERVAL
"""Image from which on one more marker is in view, and the last one in which it may not be reported yet."""


@pytest.fixture
def draw(place_markers, draw_markers):
    """Images by number: those of the markers at some of the `HOMES`, which drive to the right."""

    def image(number, ids, homes, side_px=36.0, **how):
        places = place_markers(homes + 1.5 * number, 0.3 * np.arange(ids.size), np.full(ids.size, side_px))
        return draw_markers(places, ids, SIZE, np.random.default_rng([5, number]), **how)

    return image


def look(detector, image, number):
    """Do what a live unit does with an image; return what was detected before the detector looked around."""
    seen = detector.detect(image, time_s=0.1 * number)
    if isinstance(detector, DeferringDetector):
        detector.look_around(image)
    return seen


def test_without_news_all_is_as_if_searched_at_once(draw) -> None:
    both = PhotometricDetector(DICTIONARY), DeferringDetector(DICTIONARY)
    for number in range(2 * LOOK_AROUND_INTERVAL + 3):
        image = draw(number, IDS, HOMES)
        at_once, later = (look(detector, image, number) for detector in both)
        assert later.ids.tolist() == IDS.tolist()
        np.testing.assert_allclose(later.corners_px, at_once.corners_px, atol=1e-3)


def test_complete_image_is_reported_before_it_is_searched(draw, monkeypatch) -> None:
    detector, searched = DeferringDetector(DICTIONARY), []
    search = detector._search
    monkeypatch.setattr(
        detector, "_search", lambda *given, **how: searched.append(1) or search(*given, **how)
    )
    for number in range(2 * LOOK_AROUND_INTERVAL):
        look(detector, draw(number, IDS, HOMES), number)
    assert searched == [1], "the first image alone"


def test_a_marker_that_comes_is_found_in_its_turn(draw) -> None:
    """By the next search of who searches at once, by the end of the look around of who does so later."""
    first: dict[type, int] = {}
    for detector in (PhotometricDetector(DICTIONARY), DeferringDetector(DICTIONARY)):
        for number in range(LATEST + 3):
            here = slice(None) if number >= COMES else slice(0, 5)
            seen = look(detector, draw(number, IDS[here], HOMES[here]), number)
            assert seen.ids.tolist() == sorted(seen.ids.tolist())
            if IDS[5] in seen.ids:
                first.setdefault(type(detector), number)
                assert seen.ids.tolist() == IDS.tolist()
    assert COMES < first[PhotometricDetector] <= COMES + SEARCH_INTERVAL
    assert COMES < first[DeferringDetector] <= LATEST


def test_each_search_runs_once_in_ten_images_and_never_two(draw, monkeypatch) -> None:
    """The first image is searched before it is reported; the last of the parts is ten images later."""
    detector, done = DeferringDetector(DICTIONARY), []
    quads = detector._quads
    monkeypatch.setattr(
        detector, "_quads", lambda part, *given: done.append((number, part)) or quads(part, *given)
    )
    for number in range(3 * LOOK_AROUND_INTERVAL + 1):
        look(detector, draw(number, IDS, HOMES), number)
    assert done == [(tens + 9 + part, part) for tens in (0, 10, 20) for part in range(2)]


def test_look_around_that_is_called_rarely_searches_each_part(draw, monkeypatch) -> None:
    """One call in 15 images: the parts take turns, and none is left out."""
    detector, done = DeferringDetector(DICTIONARY), []
    quads = detector._quads
    monkeypatch.setattr(detector, "_quads", lambda part, *given: done.append(part) or quads(part, *given))
    for number in range(61):
        image = draw(number % 10, IDS, HOMES)
        detector.detect(image, time_s=0.1 * number)
        if number and number % 15 == 0:
            detector.look_around(image)
    assert done == [0, 1, 0, 1]


@pytest.mark.parametrize("kind", [PhotometricDetector, DeferringDetector])
def test_marker_that_comes_leaves_the_plane_of_the_others(place_markers, draw_markers, kind) -> None:
    """Pixels half as high as wide: five markers show it, and one alone does not."""
    detector, squashed, planes = kind(DICTIONARY), np.diag([1.0, 0.8]), []
    for number in range(LATEST + 3):
        here = slice(None) if number >= COMES else slice(0, 5)
        places = place_markers(HOMES[here], 0.3 * np.arange(IDS[here].size), np.full(IDS[here].size, 44.0))
        places[:, :2, :2] = squashed @ places[:, :2, :2]
        rng = np.random.default_rng([6, number])
        seen = look(detector, draw_markers(places, IDS[here], SIZE, rng), number)
        planes.append(detector.states[0].plane)
    assert seen.ids.tolist() == IDS.tolist()
    assert all(plane.shared for plane in planes)
    # Of the map diag(1, 0.8): its anisotropic part over its similar part.
    np.testing.assert_allclose([plane.anisotropy for plane in planes], 0.2 / 1.8, atol=0.01)


@pytest.mark.parametrize("part", range(deferring.PARTS))
def test_each_part_of_the_search_finds_a_marker_by_itself(draw, monkeypatch, part) -> None:
    """A marker that is easily seen, with the quadrilaterals of the other parts taken away."""
    nothing = np.zeros((0, 4, 2))
    for other, name in enumerate(("find_quads", "find_small_quads")):
        if other != part:
            monkeypatch.setattr(deferring, name, lambda *given: nothing)
    detector = DeferringDetector(DICTIONARY)
    for number in range(LATEST + 2):
        here = slice(None) if number >= COMES else slice(0, 5)
        seen = look(detector, draw(number, IDS[here], HOMES[here]), number)
    assert seen.ids.tolist() == IDS.tolist()


def test_a_marker_that_jumps_is_searched_for_at_once(draw) -> None:
    detector = DeferringDetector(DICTIONARY)
    for number, homes in enumerate([HOMES[:5], HOMES[:5], HOMES[[0, 1, 2, 3, 5]]]):
        assert look(detector, draw(number, IDS[:5], homes), number).ids.tolist() == IDS[:5].tolist()


def test_id_found_at_a_second_place_is_no_longer_reported(draw) -> None:
    detector, twice = DeferringDetector(DICTIONARY), np.append(IDS[:5], IDS[2])
    for number in range(LATEST + 2):
        here = number >= COMES
        ids, homes = (twice, HOMES) if here else (IDS[:5], HOMES[:5])
        seen = look(detector, draw(number, ids, homes), number)
    assert seen.ids.tolist() == np.delete(IDS[:5], 2).tolist()


def test_units_are_independent_and_unseen_units_not_searched(draw) -> None:
    detector = DeferringDetector(DICTIONARY)
    for number in range(LOOK_AROUND_INTERVAL - 1):
        detector.detect(draw(number, IDS, HOMES), time_s=0.1 * number, unit_id=0)
    before = detector.states[0].unsearched
    detector.look_around(draw(number, IDS, HOMES), unit_id=1)
    assert detector.states[0].unsearched == before and 1 not in detector.states


def test_an_image_that_is_none_is_refused() -> None:
    with pytest.raises(InputError, match="grey"):
        DeferringDetector(DICTIONARY).look_around(np.zeros((8, 8, 3), np.uint8))


def test_only_the_detector_that_follows_can_search_later() -> None:
    made = {name: create_detector(name, deferring=True) for name in ("tracking", "photometric", "opencv")}
    assert [name for name, each in made.items() if isinstance(each, DeferringDetector)] == ["tracking"]
    assert not isinstance(create_detector("tracking"), DeferringDetector)
