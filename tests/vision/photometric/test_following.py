"""Followed markers that are not where they were expected: the camera moved otherwise, or the robots did."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from skyherd.geometry import wrap_angle
from skyherd.vision import PhotometricDetector
from skyherd.vision.photometric import following
from skyherd.vision.photometric.fitting.local_homography import LocalHomographies
from skyherd.vision.photometric.tracks import apply_similarity, common_motion, find_quads_near, innermost
from skyherd.vision.search.quads import find_quads

DICTIONARY, SIZE, SIDE_PX = "4X4_50", (640, 480), 30.0
MIDDLE = complex(SIZE[0] - 1, SIZE[1] - 1) / 2
HOMES = np.add.outer(1j * np.arange(90, 450, 100), np.arange(100, 600, 110)).ravel()
IDS = np.arange(HOMES.size)
SEEN = np.zeros(HOMES.size, dtype=np.int64)
"""Images in which each marker was missed."""
HEADINGS = 0.4 * np.arange(HOMES.size)


def markers(centers, similarities) -> LocalHomographies:
    nothing = np.zeros(len(centers), dtype=complex)
    return LocalHomographies(
        np.asarray(centers, complex), np.asarray(similarities, complex), nothing, nothing
    )


@given(
    a=st.complex_numbers(min_magnitude=0.8, max_magnitude=1.25),
    b=st.complex_numbers(max_magnitude=100),
    seed=st.integers(0, 2**31),
    count=st.integers(3, 8),
)
def test_common_motion_is_independent_of_robot_rotations(a, b, seed, count) -> None:
    rng = np.random.default_rng(seed)
    before = markers(rng.uniform(0, 600, (count, 2)) @ [1, 1j], 20 * np.exp(1j * rng.uniform(-3, 3, count)))
    after = apply_similarity(before, (a, b))
    turned = markers(after.centers, after.similarities * np.exp(1j * rng.uniform(-3, 3, count)))
    found = common_motion(before, turned)
    assert found == (pytest.approx(a, abs=1e-9), pytest.approx(b, abs=1e-6))


@pytest.mark.parametrize("count", [1, 2])
def test_one_or_two_markers_give_scale_by_side_and_no_rotation(count) -> None:
    """Though each turned by itself, and two drove past one another."""
    before = markers([100 + 50j, 160 + 50j][:count], [20, 20j][:count])
    own_ways = np.array([0j]) if count == 1 else np.array([4j, -4j])
    after = markers(before.centers * 1.1 + 7 + own_ways, before.similarities * 1.1 * np.exp(0.5j))
    assert common_motion(before, after) == (pytest.approx(1.1), pytest.approx(7))


def test_tilt_stays_where_it_is_in_the_images_axes() -> None:
    """A camera that yaws takes its tilt along: the relative anisotropy k / conj(m) and the horizon stay."""
    before = LocalHomographies(np.array([3 + 1j]), np.array([20j]), np.array([1 - 2j]), np.array([1e-4 + 0j]))
    after = apply_similarity(before, (1.05 * np.exp(0.3j), 5.0))
    assert after.anisotropies / after.similarities.conj() == pytest.approx(
        before.anisotropies / before.similarities.conj()
    )
    assert after.perspectives == pytest.approx(before.perspectives)
    assert after.sides_px() == pytest.approx(1.05 * before.sides_px())


@pytest.fixture
def sequence(place_markers, draw_markers):
    """Images by number: markers that drive to the right, changed in some way from the fifth image on."""

    def image(number: int, change=lambda homes, headings: (homes, headings, 1.0)):
        homes, headings, scale = HOMES + 1.5 * number, HEADINGS, 1.0
        if number >= 4:
            homes, headings, scale = change(homes, headings)
        places = place_markers(homes, headings, np.full(homes.size, scale * SIDE_PX))
        return draw_markers(places, IDS, SIZE, np.random.default_rng([7, number])), homes, headings

    return image


def zoomed(homes, headings):
    """The camera has sunk by a twentieth: markers in the corners move by half a side."""
    return MIDDLE + 1.05 * (homes - MIDDLE), headings, 1.05


def panned(homes, headings):
    """The camera flies on by half a side an image, which it did not before."""
    return homes + (13 - 9j), headings, 1.0


def yawed(homes, headings):
    """The camera has turned by three degrees: by half a side in the corners."""
    turn = np.exp(0.055j)
    return MIDDLE + turn * (homes - MIDDLE), headings + 0.055, 1.0


def scattered(homes, headings):
    """Robots set off: each has turned by up to a radian and gone some way, as no other has."""
    rng = np.random.default_rng(3)
    ways = rng.uniform(-0.4, 0.4, (homes.size, 2)) @ [1, 1j] * SIDE_PX
    return homes + ways, headings + rng.uniform(-1, 1, homes.size), 1.0


def turned(homes, headings):
    """Robots begin to turn on the spot, some fast and some slowly."""
    return homes, headings + np.linspace(0.4, 1.4, homes.size), 1.0


CHANGES = [zoomed, panned, yawed, scattered, turned]


def followed(sequence, change, monkeypatch):
    """Return the detections in six images of a sequence, and the numbers of those that were searched."""
    looked, real = [], PhotometricDetector._search_with_fallback
    monkeypatch.setattr(
        PhotometricDetector, "_search_with_fallback", lambda *given: looked.append(number) or real(*given)
    )
    detector, seen = PhotometricDetector(DICTIONARY), []
    for number in range(6):
        seen.append(detector.detect(sequence(number, change)[0], time_s=0.1 * number))
    return seen, looked


@pytest.mark.parametrize("change", CHANGES, ids=lambda change: change.__name__)
def test_markers_that_all_moved_are_found_without_full_search(sequence, monkeypatch, change) -> None:
    """All twenty, and measured as in an image by itself: to a fifth of their standard deviations."""
    seen, looked = followed(sequence, change, monkeypatch)
    assert looked == [0]
    for number in (4, 5):
        alone = PhotometricDetector(DICTIONARY, following=False).detect(sequence(number, change)[0])
        assert seen[number].ids.tolist() == alone.ids.tolist() == IDS.tolist()
        stds = np.sqrt(np.diagonal(alone.covariances, axis1=1, axis2=2))
        off_px = seen[number].centers_px - alone.centers_px
        off_rad = wrap_angle(seen[number].headings_rad - alone.headings_rad)
        assert np.abs(off_px / stds[:, :2]).max() < 0.2 and np.abs(off_rad / stds[:, 2]).max() < 0.2


@pytest.mark.parametrize("change", CHANGES, ids=lambda change: change.__name__)
def test_where_they_were_predicted_most_of_them_are_not(sequence, monkeypatch, change) -> None:
    """The negative control: without the common motion and the search near the places, all is searched."""
    monkeypatch.setattr(following, "_moved", lambda image, dictionary, state, start, fits: start)
    monkeypatch.setattr(following, "find_quads_near", lambda image, places, missed: np.zeros((0, 4, 2)))
    seen, looked = followed(sequence, change, monkeypatch)
    assert looked[:2] == [0, 4] and seen[4].ids.tolist() == IDS.tolist()


@pytest.mark.parametrize("turn_rad", np.linspace(0.5, 3.1, 10).round(2).tolist())
def test_one_robot_that_turned_by_itself_is_found_near_its_place(sequence, monkeypatch, turn_rad) -> None:
    """Also where a fit at the predicted heading leaves little, since the two look alike."""
    turns = turn_rad * (IDS % 5 == 2)
    seen, looked = followed(sequence, lambda homes, headings: (homes, headings + turns, 1.0), monkeypatch)
    assert looked == [0] and seen[4].ids.tolist() == IDS.tolist()


def test_marker_leaving_the_view_causes_no_full_search(place_markers, draw_markers, monkeypatch) -> None:
    """One at the right border drives out; one that vanishes in the middle is, the negative control."""
    looked, real = [], PhotometricDetector._search_with_fallback
    monkeypatch.setattr(
        PhotometricDetector, "_search_with_fallback", lambda *given: looked.append(number) or real(*given)
    )
    detector = PhotometricDetector(DICTIONARY)
    for number in range(9):
        homes = np.array([100 + 100j, 300 + 200j, 590 + 300j + 8 * number, 200 + 380j])
        shown = np.arange(3 if number == 8 else 4)
        places = place_markers(homes[shown], np.zeros(shown.size), np.full(shown.size, SIDE_PX))
        image = draw_markers(places, shown, SIZE, np.random.default_rng([8, number]))
        seen = detector.detect(image, time_s=0.1 * number)
    assert seen.ids.tolist() == [0, 1] and looked == [0, 8]


def test_local_quad_search_matches_the_full_search(sequence) -> None:
    """At two places, one of which reaches over the border; at all places it is the whole image."""
    image, places = sequence(0)[0], HOMES[[0, 7]]
    whole = find_quads(image).mean(axis=1) @ [1, 1j]
    near = find_quads_near(image, markers(places, [30, 15]), SEEN[:2]).mean(axis=1) @ [1, 1j]
    for place in places:
        assert np.abs(near - place).min() < 0.5 and np.abs(whole - place).min() < 0.5
    away = np.abs(near[:, None] - places)
    assert (away < np.sqrt(2) * np.array([91, 46])).any(axis=1).all()
    all_of_it = find_quads_near(image, markers(HOMES, np.full(HOMES.size, 30)), SEEN).mean(axis=1) @ [1, 1j]
    assert all_of_it.tolist() == whole.tolist()


def test_the_innermost_are_nearest_to_the_images_middle() -> None:
    image = np.zeros((480, 640), dtype=np.uint8)
    chosen = innermost(markers(HOMES, np.full(HOMES.size, 20)), image).centers
    rest = np.setdiff1d(HOMES, chosen)
    assert chosen.size == 4 and np.abs(chosen - MIDDLE).max() <= np.abs(rest - MIDDLE).min()


def test_cut_to_another_view_is_measured_as_an_image_by_itself(sequence) -> None:
    """After a cut nothing is known of the markers' motion, and no place is predicted from it."""
    detector, places = PhotometricDetector(DICTIONARY), np.random.default_rng(4).permutation(HOMES.size)
    for number in range(3):
        detector.detect(sequence(number)[0], time_s=0.1 * number)
    image = sequence(5, lambda homes, headings: (homes[places] + 7, headings, 1.0))[0]
    cut = detector.detect(image, time_s=0.3)
    alone = PhotometricDetector(DICTIONARY, following=False).detect(image)
    assert cut.ids.tolist() == alone.ids.tolist() == IDS.tolist()
    np.testing.assert_allclose(cut.centers_px, alone.centers_px, atol=0.01)
    far = np.abs(HOMES[places] - HOMES) > 4 * SIDE_PX
    assert far.sum() > 10 and not detector.states[0].tracks.velocities[far].any()
