"""Choice of the candidates that are fitted, once other images have told how the markers are printed."""

import tracemalloc
from dataclasses import replace

import cv2
import numpy as np
import pytest

from skyherd.geometry import to_complex, to_points
from skyherd.markers.dictionary import corners_of_pose, marker_cells
from skyherd.vision import PhotometricDetector, Reason, explain
from skyherd.vision.photometric import measure
from skyherd.vision.photometric.candidates import (
    CLEAR_CORRELATION,
    EDGE_CORRELATION,
    best_of_decoded,
    decode_outlines,
    find_candidates,
    may_be_cut,
    non_maximum_suppression,
    outside_markers,
    within_better,
)
from skyherd.vision.photometric.fitting.local_homography import LocalHomographies
from skyherd.vision.photometric.fitting.plane import Plane
from skyherd.vision.photometric.likely import are_likely
from skyherd.vision.photometric.measure import measure_candidates
from skyherd.vision.photometric.refine import START_SIGMA_PX
from skyherd.vision.photometric.state import CameraState
from skyherd.vision.search.decode import MIN_CORRELATION, decode_quads
from skyherd.vision.search.quads import find_quads

DICTIONARY, SIZE, SIDE_PX = "4X4_50", (400, 140), 30.0
PLACES = np.array([70 + 70j, 200 + 70j, 330 + 70j])
USUAL_PRINT = 1 - 30 / 230
"""Of the markers that are drawn, black 30 on white 230."""


@pytest.fixture
def markers(place_markers, draw_markers):
    """An image of three markers, the last one's contrast and white times a factor, or blurred."""

    def draw(number=0, *, faded=1.0, blurred_px=0.0):
        places = place_markers(PLACES + number, [0.3, 1.2, 2.5], SIDE_PX)
        image = draw_markers(places, [3, 7, 12], SIZE, np.random.default_rng([9, number]), noise=0.0)
        last = image[:, 265:].astype(float)
        if blurred_px:
            last = draw_markers(
                places, [3, 7, 12], SIZE, np.random.default_rng([9, number]), noise=0.0, psf_px=blurred_px
            )[:, 265:].astype(float)
        image[:, 265:] = np.rint(170 + faded * (last - 170)).astype(np.uint8)
        return image

    return draw


def candidates(image, print_contrast, *, first_is_known=True) -> list[int]:
    """Ids of the candidates that are fitted beside marker 3, or with it if that is not known."""
    state = CameraState(sigma_px=0.85, noise=2.0, print_contrast=print_contrast)
    similarities = np.array([SIDE_PX * 1j * np.exp(0.3j)])
    first = LocalHomographies(PLACES[:1], similarities, np.zeros(1, complex), np.zeros(1, complex))
    quads_px = find_quads(image)
    if first_is_known:
        quads_px = quads_px[outside_markers(quads_px, first)]
    found = find_candidates(image, DICTIONARY, state, quads_px, beside_markers=first_is_known)
    return sorted(found.ids.tolist())


def test_what_is_much_paler_than_a_units_markers_is_not_fitted(markers) -> None:
    """Levels of 142 and 182: a print of 0.22, as dark patches of the ground have, beside 0.87."""
    pale = markers(faded=0.2)
    assert candidates(pale, USUAL_PRINT) == [7]
    assert candidates(pale, None) == candidates(pale, 0.22) == [7, 12]


def test_quadrilaterals_that_are_off_are_compared_at_their_edges(place_markers, draw_markers) -> None:
    """Markers of 14 px, corners up to 2 px off: few are clear as they are, nearly all at their edges.

    The quadrilaterals as they are, the negative control, are those of a search that asks for less.
    """
    rng = np.random.default_rng(3)
    places = np.array([30 + 40 * (k % 9) + 1j * (30 + 40 * (k // 9)) for k in range(27)])
    headings = rng.uniform(-3, 3, 27)
    image = draw_markers(place_markers(places, headings, 14.0), list(range(27)), (390, 140), rng, noise=1.0)
    quads_px = corners_of_pose(to_points(places), headings, np.full(27, 14.0))
    quads_px += rng.uniform(-2, 2, quads_px.shape)
    plain = decode_quads(image, quads_px, DICTIONARY, START_SIGMA_PX)
    assert np.count_nonzero(plain.correlations >= CLEAR_CORRELATION) < 14
    found = find_candidates(image, DICTIONARY, CameraState(), quads_px, beside_markers=False)
    assert found.ids.size >= 25 and found.correlations.min() >= EDGE_CORRELATION
    errors_px = np.abs(to_complex(found.corners_px).mean(axis=1) - places[found.ids])
    assert np.median(errors_px) < 0.2, "of a quadrilateral that is off, half a pixel"


def test_what_merely_resembles_a_marker_is_no_candidate(place_markers, draw_markers) -> None:
    """Marker 7, whose bits are white, with half of the border above and below; as it is, it is one."""
    place, side_px = np.array([60 + 60j]), 48.0
    image = draw_markers(
        place_markers(place, [0.0], side_px), [7], (120, 120), np.random.default_rng(1), noise=1.0
    )
    quads_px = corners_of_pose(to_points(place), np.zeros(1), np.array([side_px]))

    def ids() -> list[int]:
        found = find_candidates(image, DICTIONARY, CameraState(), quads_px, beside_markers=False)
        return found.ids.tolist()

    assert ids() == [7]
    image[40:80, 44:76] = 230
    alike = decode_quads(image, quads_px, DICTIONARY, START_SIGMA_PX)
    assert MIN_CORRELATION <= alike.correlations[0] < EDGE_CORRELATION
    assert ids() == []


def test_rest_of_a_marker_at_the_border_is_a_candidate_as_it_is(place_markers, draw_markers) -> None:
    """Cut within its black border, it reads worse at its edges, of which one is outside the image."""
    place = place_markers(np.array([17 + 60j]), [0.05], 48.0)
    image = draw_markers(place, [7], (120, 120), np.random.default_rng(1), noise=1.0)
    quads_px, state, ids = find_quads(image), CameraState(), []
    decoded = decode_outlines(image, DICTIONARY, state, quads_px)
    assert (decoded.correlations < CLEAR_CORRELATION).all()
    for keep in (True, False):
        best = best_of_decoded(image, DICTIONARY, state, decoded, beside_markers=False, keep_at_border=keep)
        ids.append(measure_candidates(image, DICTIONARY, state, quads_px, best).found.ids.tolist())
    assert ids == [[7], []]


def test_pale_marker_beyond_doubt_is_found_beside_others(markers) -> None:
    """An eighth of the others' contrast, by which the first search misses it; its bits leave no doubt."""
    pale, detector = markers(faded=0.12), PhotometricDetector(DICTIONARY, following=False)
    first, _ = detector.searches(pale)
    assert sorted(first.found.ids.tolist()) == [3, 7]
    assert detector.detect(pale).ids.tolist() == [3, 7, 12]


def test_only_the_marker_that_a_fit_names_is_beyond_doubt(markers) -> None:
    """Not another id, nor the same in another turn, nor a place without a marker."""
    image = markers()
    first, _ = PhotometricDetector(DICTIONARY, following=False).searches(image)
    fits, shapes = first.found, first.found.homographies
    assert are_likely(image, DICTIONARY, fits).tolist() == [True] * 3
    turned = replace(shapes, similarities=1j * shapes.similarities, anisotropies=-1j * shapes.anisotropies)
    away = replace(shapes, centers=shapes.centers + 65)
    for wrong in (
        replace(fits, ids=fits.ids + 1),
        replace(fits, homographies=turned),
        replace(fits, homographies=away),
    ):
        assert not are_likely(image, DICTIONARY, wrong).any()


def test_image_without_known_markers_is_searched_for_pale_ones(markers) -> None:
    """Haze, or a lamp, may have lifted all blacks since: the unit must find its markers again."""
    assert candidates(markers(faded=0.2), USUAL_PRINT, first_is_known=False) == [3, 7, 12]


@pytest.mark.parametrize("how", [{"faded": 0.4}, {"blurred_px": 2.4}], ids=["in shade", "out of focus"])
def test_markers_that_only_light_or_focus_make_paler_are_fitted(markers, how) -> None:
    """Levels of 114 and 194, a print of 0.41; or a blur of three times the usual."""
    assert candidates(markers(**how), USUAL_PRINT) == [7, 12]


def test_the_print_of_a_units_markers_is_learnt(markers) -> None:
    """From the fits, to a hundredth; and nothing is known where nothing is followed."""
    detector = PhotometricDetector(DICTIONARY)
    for number in range(3):
        assert len(detector.detect(markers(number), time_s=float(number))) == 3
    assert detector.states[0].print_contrast == pytest.approx(USUAL_PRINT, rel=0.01)
    assert CameraState().print_contrast is None


SLANTED = np.array([120 + 70j, 280 + 70j])


def slanted(place_markers, tilt_deg: float) -> np.ndarray:
    """Homographies of two markers side by side on faces of cubes that look left and right, seen obliquely.

    A face at a distance of 12 of its sides, turned about its upright edge, shrinks to `cos(tilt)` of its
    width, and one edge of it is nearer than the other.
    """
    places = place_markers(SLANTED, [-np.pi / 2, -np.pi / 2], 34.0)
    tilt = np.radians(tilt_deg)
    turn = np.array([[np.cos(tilt), 0, 0], [0, 1, 0], [np.sin(tilt) / 12, 0, 1]])
    return places @ np.stack([turn, turn * np.array([[1, 1, 1], [1, 1, 1], [-1, 1, 1]])])


@pytest.mark.parametrize("number", range(3))
def test_few_markers_get_no_plane_if_known_ones_have_none(place_markers, draw_markers, number) -> None:
    """Two anisotropies always lie as on some plane, here a level one, and centres are off by 0.1 px then."""
    rng = np.random.default_rng([10, number])
    image = draw_markers(slanted(place_markers, 68), [3, 7], SIZE, rng, noise=1.0)

    def errors_px(state: CameraState) -> np.ndarray:
        quads = find_quads(image)
        candidates = find_candidates(image, DICTIONARY, state, quads, beside_markers=False)
        found = measure_candidates(image, DICTIONARY, state, quads, candidates).found
        assert sorted(found.ids.tolist()) == [3, 7]
        return np.abs(found.homographies.centers[np.argsort(found.ids)] - SLANTED)

    assert (errors_px(CameraState(plane=Plane(shared=False))) < 0.03).all()
    assert (errors_px(CameraState()) > 0.1).all()


def test_half_of_a_marker_is_within_the_better_one() -> None:
    """A centre within half a side of a better marker; the better one, and one beside it, are in none."""
    centers, sides_px = np.array([100 + 100j, 106 + 100j, 140 + 100j]), np.array([22.0, 16.0, 22.0])

    def within(*photometric: bool, ids: tuple[int, ...] = (22, 17, 3)) -> list[bool]:
        return within_better(np.array(ids), centers, sides_px, np.array(photometric)).tolist()

    assert within(True, False, False) == within(True, True, True) == [False, True, False]
    assert within(False, True, True) == [True, False, False], "its centre is within a photometric one"
    assert within(False, False, False) == [False] * 3
    assert within(True, True, True, ids=(22, 22, 3)) == [False] * 3, "one marker found twice"
    assert within(True, False, True, ids=(22, 22, 3)) == [False, True, False]


def test_suppression_keeps_the_best_of_each_place_and_id() -> None:
    """Compared in pairs: what is kept has no better rival that is kept, and everything else has one."""
    rng = np.random.default_rng(7)
    count = 600
    ids, merits = rng.integers(0, 4, count), rng.uniform(size=count)
    centers, sides_px = rng.uniform(0, 300, (count, 2)) @ [1, 1j], rng.uniform(20, 80, count)
    kept = non_maximum_suppression(ids, centers, sides_px, merits)
    near = np.abs(centers[:, None] - centers) < np.minimum(sides_px[:, None], sides_px) / 2
    beats = near & (ids[:, None] == ids) & (merits[:, None] > merits)
    assert 50 < kept.sum() < 400
    np.testing.assert_array_equal(kept, ~(beats & kept[:, None]).any(axis=0))


def test_suppression_takes_memory_in_proportion() -> None:
    """5,000 candidates, as of two megapixels of text; a bit for each pair would take 25 MB."""
    count = 5000
    centers, sides_px = 40.0 * np.arange(count) + 0j, np.full(count, 10.0)
    tracemalloc.start()
    kept = non_maximum_suppression(np.zeros(count, dtype=np.int64), centers, sides_px, np.ones(count))
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert kept.all() and peak < 2e6


def rectangle(center: complex, along: complex, ratio: float) -> LocalHomographies:
    """Return the shape of a marker whose sides are `along` and a share of it, px."""
    corners = center + np.array([-1 - 1j, 1 - 1j, 1 + 1j, -1 + 1j]) / 2
    z = corners - center
    return LocalHomographies.of_corners(to_points(center + along * (z.real + 1j * ratio * z.imag))[None])


@pytest.mark.parametrize(
    ("center", "along", "ratio", "is_cut"),
    [
        pytest.param(100 + 20j, 48, 0.5, True, id="half of a marker at the upper border"),
        pytest.param(100 + 80j, 48, 0.5, False, id="in the middle"),
        pytest.param(100 + 37j, 48, 0.5, False, id="the whole square is inside"),
        pytest.param(20 + 80j, 48j, 0.5, True, id="at the left border"),
        pytest.param(185 + 80j, 48 * np.exp(1.4j), 0.5, True, id="turned, at the right border"),
        pytest.param(100 + 20j, 48, 0.9, False, id="nearly a square"),
        pytest.param(100 + 30j, 24, 2.0, False, id="narrower along the border"),
    ],
)
def test_parts_of_cut_markers_are_recognized(center, along, ratio, is_cut) -> None:
    assert may_be_cut(rectangle(center, along, ratio), Plane(), (200, 160)).tolist() == [is_cut]


def test_tilt_of_the_plane_makes_no_part_of_a_marker() -> None:
    shape = rectangle(100 + 20j, 48, 0.5)
    tilted = Plane((shape.anisotropies / shape.similarities.conj())[0])
    assert not may_be_cut(shape, tilted, (200, 160)).any()


def test_rhombus_is_no_part_of_a_marker() -> None:
    """A marker that is tilted about its diagonal has its anisotropy off its own axes."""
    square = rectangle(100 + 20j, 48, 1.0)
    rhombus = replace(square, anisotropies=square.similarities * 0.33j)
    assert not may_be_cut(rhombus, Plane(), (200, 160)).any()


@pytest.fixture
def half_of_22():
    """An image in which the border cuts marker 22; its right half is marker 17 at 60 degrees."""
    cells = np.pad(marker_cells(DICTIONARY, 22).astype(float), 1, constant_values=1.0)
    image = np.full((200, 200), 130.0)
    image[60:124, :48] = 255 * np.kron(cells, np.ones((8, 8)))[:, 16:]
    return np.rint(cv2.GaussianBlur(image, (0, 0), 0.7)).astype(np.uint8)


def test_half_of_a_cut_marker_is_no_other_marker(half_of_22, monkeypatch) -> None:
    detect = PhotometricDetector(DICTIONARY, following=False).detect
    assert not detect(half_of_22).ids.size
    (found,) = explain(half_of_22, DICTIONARY)
    assert found.reason is Reason.PART and "half of a marker" in found.words and "id 17" in found.words
    monkeypatch.setattr(measure, "may_be_cut", lambda shapes, *rest: np.zeros(len(shapes), dtype=bool))
    assert detect(half_of_22).ids.tolist() == [17]


@pytest.mark.parametrize(("shared", "ids"), [(True, [17]), (False, [])])
def test_other_markers_show_that_a_narrow_one_is_whole(half_of_22, shared, ids) -> None:
    """The plane that they lie on is tilted about a vertical axis."""
    _, seen = PhotometricDetector(DICTIONARY, following=False).searches(half_of_22)
    given = half_of_22, DICTIONARY, CameraState(), seen.quads_px, seen.candidates
    searched = measure_candidates(*given, Plane(-1 / 3 + 0j, shared=shared))
    assert searched.found.ids.tolist() == ids


@pytest.mark.parametrize(("keystone", "is_found"), [(0.3, True), (0.8, False)])
def test_markers_by_their_edges_have_the_shape_of_squares(monkeypatch, keystone, is_found) -> None:
    """No fit is verified, so that the log odds decide."""
    monkeypatch.setattr(measure, "verified", lambda fits, *rest: np.zeros(fits.ids.size, dtype=bool))
    cells = np.pad(marker_cells(DICTIONARY, 17).astype(np.float32), 1, constant_values=1.0)
    card = 255 * np.kron(cells, np.ones((16, 16), dtype=np.float32))
    middle = (len(card) - 1) / 2
    bend = np.array([[1, 0, 0], [0, 1, 0], [0, keystone / (16 * 6), 1]])
    there, back = np.eye(3), np.eye(3)
    there[:2, 2], back[:2, 2] = 120, -middle
    image = cv2.warpPerspective(card, there @ bend @ back, (240, 240), borderValue=255)
    image = np.rint(cv2.GaussianBlur(image, (0, 0), 0.7)).astype(np.uint8)
    found = PhotometricDetector(DICTIONARY, following=False).detect(image)
    assert (found.ids.tolist() == [17]) == is_found
