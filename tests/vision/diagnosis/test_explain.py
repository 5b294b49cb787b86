"""Each reason on an image that has exactly that fault, and none on the same image without it."""

from collections.abc import Callable
from dataclasses import replace

import cv2
import numpy as np
import pytest

from skyherd.errors import InputError
from skyherd.markers.dictionary import cells_per_side, code_distance, corners_of_pose, marker_cells
from skyherd.messages import Quality
from skyherd.render import Camera, CameraPose, Ground, Renderer, Sensor, Shot
from skyherd.vision import PhotometricDetector, create_detector
from skyherd.vision.diagnosis.explain import Rejection, detect_and_explain, explain
from skyherd.vision.diagnosis.reading import Reading
from skyherd.vision.diagnosis.reasons import (
    FAILED,
    LEGIBLE_BLUR_CELLS,
    Reason,
    Stage,
    describe,
    failed_test,
    find_reason,
)
from skyherd.vision.photometric.fitting.fit_result import FitResults
from skyherd.vision.photometric.fitting.local_homography import LocalHomographies
from skyherd.vision.photometric.image_noise import image_noise
from skyherd.vision.photometric.verify import Quantity, WrongCellResiduals, verification_tests, verified
from skyherd.vision.prints.suggestions import suggest

DICTIONARY = "4X4_50"
WIDE = "4X4_50@2"
"""The same with a border of two cells."""

IDS = [3, 7, 12, 21]
PLACES_PX = np.array([[110.0, 110], [290, 110], [110, 290], [290, 290]])

Draw = Callable[..., np.ndarray]


@pytest.fixture(scope="module")
def ground() -> Ground:
    return Ground(20)


@pytest.fixture(scope="module")
def draw(ground) -> Draw:
    """Four markers at PLACES_PX, heading 0.3, 1, 2 and -2, in 400 x 400 px of textured ground."""

    def make(
        side_px: float = 40, *, ids=IDS, dictionary=DICTIONARY, psf_px=0.8, black=30.0, white=230.0, noise=2.0
    ) -> np.ndarray:
        sensor = Sensor(noise, np.random.default_rng(2))
        renderer = Renderer(dictionary, 1.0, ground, sensor, psf_px=psf_px, black=black, white=white)
        places = (PLACES_PX - 199.5) / side_px * (1, -1)
        headings = -np.array([0.3, 1, 2, -2])[: len(ids)]
        camera, pose = Camera((400, 400), 10 * side_px), CameraPose((0.0, 0.0), 10.0)
        return renderer.render(Shot(camera, pose, np.array(ids), places[: len(ids)], headings))

    return make


def likely(image: np.ndarray, dictionary: str = DICTIONARY) -> list[Rejection]:
    return [r for r in explain(image, dictionary) if r.reason is not Reason.NO_BITS]


def explained_at(image: np.ndarray, place_px: np.ndarray) -> Rejection:
    """The one rejection within 10 px of a place."""
    near = [r for r in likely(image) if np.linalg.norm(r.center_px - place_px) < 10]
    assert len(near) == 1, [(r.reason, r.center_px) for r in near]
    return near[0]


def read_marker(image: np.ndarray) -> Reading:
    """The first marker of an image that shows it well, as it is explained to those who did not find it."""
    found = create_detector(dictionary=DICTIONARY).detect(image)
    return next(r.reading for r in explain(image, DICTIONARY, found.select([])) if r.reading)


def check(rejections: list[Rejection], reason: Reason, ids: list[int]) -> None:
    """All are of that reason and about those ids, each with a quantity that breaks its limit and in words."""
    assert {(r.reason, r.reading.nearest_id) for r in rejections} == {(reason, k) for k in ids}
    for r in rejections:
        assert r.measured is not None and str(r.measured) in r.words
        beyond = (
            r.measured.limit - r.measured.value
            if r.measured.at_least
            else r.measured.value - r.measured.limit
        )
        assert beyond > 0
        assert ": " in r.words.split(str(r.measured))[1], "what to do comes after it"


@pytest.mark.parametrize("dictionary", [DICTIONARY, WIDE])
def test_nothing_is_rejected_where_all_is_well(draw, dictionary) -> None:
    """The control of all below: the same picture without a fault."""
    image = draw(dictionary=dictionary)
    found = create_detector(dictionary=dictionary).detect(image)
    assert found.ids.tolist() == IDS
    assert explain(image, dictionary) == explain(image, dictionary, found) == []


@pytest.mark.parametrize("repeats", [False, True])
def test_one_search_detects_and_explains(draw, repeats) -> None:
    """An id at two places, and another marker half of which is covered, in one call as in two."""
    image = draw(30, ids=[3, 7, 7, 21])
    image[:110, :200] = 200
    found, rejected = detect_and_explain(image, DICTIONARY, repeats=repeats, time_s=2.0)
    expected = create_detector(dictionary=DICTIONARY, repeats=repeats).detect(image, time_s=2.0)
    assert found.time_s == 2.0
    assert found.ids.tolist() == expected.ids.tolist() == ([7, 7, 21] if repeats else [21])
    np.testing.assert_array_equal(found.centers_px, expected.centers_px)
    np.testing.assert_array_equal(found.covariances, expected.covariances)
    assert [r.words for r in rejected] == [r.words for r in explain(image, DICTIONARY, expected)]
    assert rejected


def test_explain_says_if_the_default_detector_finds_a_marker(draw) -> None:
    image = draw()
    found = create_detector(dictionary=DICTIONARY).detect(image).select([3, 7, 12])
    (r,) = explain(image, DICTIONARY, found)
    assert (r.reason, r.reading.nearest_id, r.measured) == (Reason.OVERLOOKED, 21, None)
    assert "photometric finds id 21" in r.words


def test_too_few_pixels(draw) -> None:
    """Markers of 6.5 px have a pixel a cell; outlines of them are right to a pixel."""
    rejected = likely(draw(6.5))
    assert len(rejected) >= 2
    for r in rejected:
        assert r.reason is Reason.FEW_PIXELS and r.measured.limit == 8.0
        assert r.measured.value == pytest.approx(6.5, abs=1.0) and "fly lower" in r.words


def test_markers_that_a_sharp_image_blurs_are_too_small(draw) -> None:
    """The same blur in cells, of small markers under the usual blur and of large ones out of focus."""
    reading, sizes = replace(read_marker(draw()), blur_cells=0.72, likeness=0.95), {}
    for factor in (1.0, 0.2):
        small = replace(reading, corners_px=factor * reading.corners_px, cell_px=factor * reading.cell_px)
        reason, measured = find_reason(small, Stage.FITTED, None, -np.inf, again=False)
        sizes[factor] = reason, measured.value / measured.limit
    assert sizes[1.0][0] is Reason.BLURRED and sizes[0.2][0] is Reason.FEW_PIXELS
    assert sizes[1.0][1] == pytest.approx(1 / sizes[0.2][1]), "as much smaller as it is too blurred"


@pytest.mark.smoke
@pytest.mark.parametrize("contrast", [11.0, 18.0])
def test_low_contrast(draw, contrast) -> None:
    """Refused by its fit, and faint enough to be lost in the search."""
    image = draw(black=112.0, white=112.0 + contrast, noise=1.0)
    found = create_detector(dictionary=DICTIONARY).detect(image)
    check(likely(image), Reason.LOW_CONTRAST, sorted(set(IDS) - set(found.ids.tolist())))
    for r in likely(image):
        assert r.measured.value == pytest.approx(contrast, abs=2)


def test_too_blurred(draw) -> None:
    """Cells of 6.7 px under 5.5 px, in which no outline is right."""
    rejected = likely(draw(psf_px=5.5))
    assert len(rejected) >= 2
    for r in rejected:
        assert r.reason is Reason.BLURRED and "focus" in r.words
        assert r.measured.limit == LEGIBLE_BLUR_CELLS
        assert r.measured.value == pytest.approx(5.5 / (40 / 6), abs=0.15)


def laid_on_ground(ground: int, dictionary: str = DICTIONARY) -> np.ndarray:
    """Four markers cut out along their black and laid on ground of a grey level."""
    rng = np.random.default_rng(0)
    image = np.full((400, 400), ground, np.uint8)
    for marker_id, (u, v) in zip(IDS, PLACES_PX.astype(int), strict=True):
        marker = np.where(marker_cells(dictionary, marker_id), 230, 30).astype(np.uint8)
        marker = cv2.resize(marker, (80, 80), interpolation=cv2.INTER_NEAREST)
        image[v - 40 : v + 40, u - 40 : u + 40] = marker
    turn = cv2.getRotationMatrix2D((200, 200), 20, 1.0)
    image = cv2.GaussianBlur(cv2.warpAffine(image, turn, (400, 400), borderValue=ground), (0, 0), 0.8)
    return np.clip(image + rng.normal(0, 2, image.shape), 0, 255).astype(np.uint8)


@pytest.mark.parametrize("dictionary", [DICTIONARY, WIDE])
def test_no_quiet_zone(dictionary) -> None:
    """The ground is a little brighter than the black, so that the outline can just be seen."""
    rejected = likely(laid_on_ground(50, dictionary), dictionary)
    assert sorted(r.reading.nearest_id for r in rejected) == IDS
    turn = cv2.getRotationMatrix2D((200, 200), 20, 1.0)
    for r in rejected:
        assert r.reason is Reason.NO_QUIET_ZONE and "4 of its 4 edges" in r.words
        wanted = (PLACES_PX[IDS.index(r.reading.nearest_id)] - 0.5) @ turn[:, :2].T + turn[:, 2]
        np.testing.assert_allclose(r.center_px, wanted, atol=2)


def test_rival_is_named_if_and_only_if_odds_are_not_hopeless(draw) -> None:
    """Markers without a margin are hopeless, faint ones not, and what has no bits has no rival either."""
    plain = np.full((160, 160), 220, dtype=np.uint8)
    plain[40:120, 40:120] = 30
    explained = explain(laid_on_ground(50, WIDE), WIDE) + explain(plain, WIDE)
    explained += likely(draw(black=112.0, white=123.0, noise=1.0))
    assert {bool(np.isfinite(r.log_odds)) for r in explained if r.reading} == {True, False}
    assert any(r.reason is Reason.NO_BITS for r in explained)
    for r in explained:
        assert bool(r.rival) == bool(np.isfinite(r.log_odds)) == ("log odds" in r.words)
        if r.rival:
            assert f"{r.log_odds:.1f} against {r.rival}" in r.words
            assert r.log_odds <= r.against.min(), "all rivals together are likelier than one"


def test_cut_by_the_border(draw) -> None:
    """The left of the picture cut off through two markers, of which a little over half is left."""
    whole, cut = draw(60), 105
    rejected = likely(np.ascontiguousarray(whole[:, cut:]))
    check(rejected, Reason.CUT, [3, 12])
    for r in rejected:
        assert r.measured.name == "share of its area in the image" and r.measured.limit == 0.8
        assert np.abs(r.center_px[0] + cut - PLACES_PX[0, 0]) < 4


def cut_marker(marker_id: int, columns: float, cell_px: int = 12) -> np.ndarray:
    """A marker on a card, of which the right border of the image leaves so many columns of cells."""
    cells = np.pad(np.where(marker_cells(DICTIONARY, marker_id), 230, 30), 1, constant_values=230)
    card = np.kron(cells, np.ones((cell_px, cell_px)))
    image = np.full((200, 240), 140, np.uint8)
    image[50 : 50 + len(card), 100 : 100 + len(card)] = card
    return np.ascontiguousarray(cv2.GaussianBlur(image, (0, 0), 0.8)[:, : int(100 + cell_px * (1 + columns))])


@pytest.mark.parametrize(("columns", "least"), [(3.0, 12), (4.5, 13), pytest.param(4.0, 12)])
def test_markers_of_which_half_is_left_are_named(columns, least) -> None:
    """Every fourth marker: nearly all are cut by the border, and none is named after another."""
    named = 0
    for marker_id in range(0, 50, 4):
        for r in likely(cut_marker(marker_id, columns)):
            assert (r.reason, r.reading.nearest_id) == (Reason.CUT, marker_id)
            named += 1
    assert named >= least


@pytest.mark.parametrize("marker_id", [3, 35, 41, 43, 0, 10])
def test_outline_that_the_border_cuts_is_not_read_as_a_marker(marker_id) -> None:
    """Of two and a half columns too few bits are left; the first four read as other markers, stretched."""
    assert likely(cut_marker(marker_id, 2.5)) == []


def test_candidates_unlike_markers_are_explained_by_log_odds(draw) -> None:
    """A faint reading is explained if it is likelier a marker than not, and by its likeness otherwise."""
    unlike = replace(read_marker(draw()), likeness=0.8, has_frame=False)
    reasons = [
        find_reason(unlike, Stage.FITTED, None, log_odds, again=False)[0] for log_odds in (-np.inf, 1.0, 3.0)
    ]
    assert reasons == [Reason.NO_BITS, Reason.NO_BITS, Reason.NO_OUTLINE]


def test_candidates_are_explained_by_what_spoils_them(draw) -> None:
    """The same reading with cells beyond the border, without a margin, with a wrong cell, and as it is."""
    reading = read_marker(draw())
    for one, stage, reason in (
        (replace(reading, visible=0.8), Stage.CUT, Reason.CUT),
        (replace(reading, dark_edges=2), Stage.UNSEEN, Reason.NO_QUIET_ZONE),
        (replace(reading, wrong_cells=((2, 3),)), Stage.DECODED, Reason.WRONG_BITS),
        (reading, Stage.UNSEEN, Reason.NO_OUTLINE),
        (reading, Stage.PART, Reason.PART),
        (reading, Stage.MIRRORED, Reason.MIRRORED),
    ):
        assert find_reason(one, stage, None, -np.inf, again=False)[0] is reason


def test_shape_without_a_marker_border_is_not_called_a_marker(draw) -> None:
    image = draw(60)
    image[150:200, :40] = 25
    assert likely(image) == []


def test_too_oblique(draw) -> None:
    """At acos(0.2) = 78.5 deg the anisotropy is `(1 - 0.2) / (1 + 0.2)` = 0.67."""
    image = cv2.resize(draw(60, noise=0.0), (400, 80), interpolation=cv2.INTER_AREA)
    rejected, seen = likely(image), create_detector().detect(image)
    lost = sorted(set(IDS) - set(seen.ids.tolist()))
    check(rejected, Reason.OBLIQUE, lost)
    assert lost and not len(seen.of_quality(Quality.PHOTOMETRIC)), "others are read, but not fitted"
    for r in rejected:
        assert r.measured.value == pytest.approx(0.667, abs=0.01) and r.measured.limit == 0.6
        assert r.reading.tilt_deg == pytest.approx(78.5, abs=4)


def painted_over(image: np.ndarray, cells: np.ndarray, n: int = 6) -> np.ndarray:
    """Id 3 of 60 px and n x n cells with some (row, column), from 0, painted black."""
    ahead = np.array([np.cos(0.3), np.sin(0.3)])
    right = np.array([-ahead[1], ahead[0]])
    for row, column in cells:
        middle = PLACES_PX[0] + 60 * ((0.5 - (row + 0.5) / n) * ahead + ((column + 0.5) / n - 0.5) * right)
        square = corners_of_pose([middle], [0.3], [63 / n])[0]
        cv2.fillPoly(image, [np.rint(square * 16).astype(np.int32)], 30, cv2.LINE_AA, 4)
    return image


@pytest.mark.parametrize(
    ("count", "dictionary"), [(1, DICTIONARY), (1, WIDE), pytest.param(2, DICTIONARY, marks=pytest.mark.slow)]
)
def test_wrong_bits_which_and_how_many(draw, count, dictionary) -> None:
    """White cells of id 3 painted over: it is still most like id 3, and these cells are named."""
    cells, n = np.argwhere(marker_cells(dictionary, 3))[:count], cells_per_side(dictionary)
    (r,) = likely(painted_over(draw(60, dictionary=dictionary), cells, n), dictionary)
    assert np.linalg.norm(r.center_px - PLACES_PX[0]) < 10
    assert (r.reason, r.reading.nearest_id, r.measured.value) == (Reason.WRONG_BITS, 3, count)
    assert r.reading.wrong_cells == tuple((row + 1, column + 1) for row, column in cells.tolist())
    named = ", ".join(f"{row + 1}.{column + 1}" for row, column in cells.tolist())
    assert f"{count} of {n * n} cells" in r.words and "id 3" in r.words and f"(row.column {named})" in r.words


def test_a_corner_that_is_covered(draw) -> None:
    image = draw(60)
    cv2.circle(image, (80, 85), 17, 205, -1, cv2.LINE_AA)
    r = explained_at(image, PLACES_PX[0])
    assert r.reason is Reason.WRONG_BITS and r.reading.nearest_id == 3 and "covered" in r.words


def test_markers_of_another_dictionary(draw) -> None:
    rejected = likely(draw(50, ids=[5, 60, 70, 99], dictionary="5X5_100"))
    assert len(rejected) == 4
    for r in rejected:
        assert r.reason is Reason.WRONG_BITS and r.measured.value >= 2
        assert "of another dictionary than 4X4_50" in r.words


def broken(fits: FitResults, quantity: Quantity) -> FitResults:
    """Fits of which the first is changed so that it fails the test of one quantity, and none before it."""
    row, wrong = np.array([0]), WrongCellResiduals.of(fits)
    similarity, side = fits.homographies.similarities[0], fits.homographies.sides_px()[0]
    n = fits.cell_means.shape[1]
    checks = np.where(np.indices((n, n)).sum(axis=0) % 2, 1.0, -1.0)
    one_cell = np.zeros((n, n))
    one_cell[2, 3] = 0.45 * wrong.means[0]
    grown = replace(fits.homographies, anisotropies=np.full(len(fits.ids), 0.61 * similarity))
    with_keystones = replace(fits.homographies, perspectives=np.full(len(fits.ids), 0.5 / side + 0j))
    changes = {
        Quantity.CELL_SIZE: {"homographies": fits.homographies.scaled(side / (0.7 * n))},
        Quantity.CONTRAST: {"contrasts": [11.0]},
        Quantity.WHITE: {"blacks": [150.0]},
        Quantity.BLUR: {"blurs_cells": [0.76]},
        Quantity.AREA: {"pixels": [0.7 * side**2]},
        Quantity.ANISOTROPY: {"homographies": grown},
        Quantity.KEYSTONE: {"homographies": with_keystones},
        Quantity.WORST_CELL: {"cell_means": one_cell[None]},
        Quantity.LAST_STEP: {"moved_px": [0.31]},
        Quantity.CELL_NOISE: {"noise_stds": 0.13 * wrong.means[:1] * wrong.cells_px[:1]},
        Quantity.PIXEL_RESIDUAL: {"noise_stds": [0.17 * fits.contrasts[0]]},
        Quantity.CELL_RESIDUAL: {"cell_means": 0.14 * fits.contrasts[0] * checks[None]},
        Quantity.PRINT_CONTRAST: {"blacks": fits.blacks[:1] + 110, "contrasts": fits.contrasts[:1] - 110},
    }[quantity]
    first = fits.take(row)
    values = {
        name: value.take(row) if isinstance(value, LocalHomographies) else np.asarray(value, dtype=float)
        for name, value in changes.items()
    }
    return fits.put(row, replace(first, **values))


@pytest.mark.parametrize("quantity", Quantity)
def test_each_test_of_a_fit_is_named_with_its_value_and_limit(draw, quantity) -> None:
    """Good fits, one of them changed in one respect: that very test is told, the fit is refused, its reason
    has words with the numbers, and the other fits stay good."""
    image = draw()
    first, _ = PhotometricDetector(DICTIONARY, following=False).searches(image)
    noise, distance = image_noise(image), code_distance(DICTIONARY)
    assert verified(first.found, noise, distance).all() and len(first.found.ids) == 4
    fits = broken(first.found, quantity)
    assert verified(fits, noise, distance).tolist() == [False, True, True, True]
    tests = verification_tests(fits, noise, distance)
    assert {test.quantity for test in tests} == set(Quantity)
    assert [failed_test(tests, row) for row in (1, 2, 3)] == [None] * 3
    named, measured = failed_test(tests, 0)
    assert named is quantity
    reading = read_marker(image)
    reason, told = find_reason(reading, Stage.FITTED, (named, measured), 5.0, again=False)
    assert reason is FAILED[quantity][0] and told is measured
    assert str(measured) in describe(reason, measured, reading, DICTIONARY)
    assert (measured.value < measured.limit) == measured.at_least


@pytest.mark.parametrize("count", [2, pytest.param(4, marks=pytest.mark.slow)])
def test_mirrored(draw, count) -> None:
    ids = IDS[:count]
    rejected = likely(np.ascontiguousarray(draw(ids=ids)[:, ::-1]))
    assert {(r.reason, r.reading.nearest_id) for r in rejected} == {(Reason.MIRRORED, k) for k in ids}


def test_symmetric_markers_are_never_called_mirrored(draw) -> None:
    """8, 9, 17 and 47 of 4X4_50 in a picture and in its mirror image: found in both, or too faint in both."""
    own = [8, 9, 17, 47]
    for turn in (1, -1):
        assert likely(np.ascontiguousarray(draw(ids=own)[:, ::turn])) == []
        faint = draw(ids=own, black=113.0, white=123.0, noise=1.0)
        check(likely(np.ascontiguousarray(faint[:, ::turn])), Reason.LOW_CONTRAST, own)
    mixed = likely(np.ascontiguousarray(draw(ids=[8, 9, 3, 7])[:, ::-1]))
    assert {(r.reason, r.reading.nearest_id) for r in mixed} == {(Reason.MIRRORED, 3), (Reason.MIRRORED, 7)}


def test_mirror_images_of_all_markers_are_told_from_markers() -> None:
    """Every marker of 4X4_50 mirrored: it is called so unless a marker in any turn has the same cells."""
    cells = [marker_cells(DICTIONARY, k) for k in range(50)]
    turned = {np.rot90(cell, turn).tobytes(): k for k, cell in enumerate(cells) for turn in range(4)}
    own = {k: turned[c[:, ::-1].tobytes()] for k, c in enumerate(cells) if c[:, ::-1].tobytes() in turned}
    assert own == {8: 8, 9: 9, 17: 17, 47: 47}
    image = np.full((560, 640), 220, np.uint8)
    for k, cell in enumerate(cells):
        v, u = 80 * (k // 8) + 20, 80 * (k % 8) + 20
        image[v : v + 42, u : u + 42] = np.where(np.kron(cell[:, ::-1], np.ones((7, 7))), 220, 40)
    image = cv2.GaussianBlur(image, (0, 0), 0.8)
    found, rejected = detect_and_explain(image, DICTIONARY)
    assert found.ids.tolist() == sorted(own)
    assert {r.reason for r in rejected} == {Reason.MIRRORED}
    for r in rejected:
        column, row = ((r.center_px - 40.5) / 80).round().astype(int)
        assert r.reading.nearest_id == 8 * row + column
    assert len(rejected) == 46


def test_an_id_that_is_there_twice(draw) -> None:
    rejected = likely(draw(ids=[3, 7, 3, 21]))
    assert [(r.reason, r.reading.nearest_id) for r in rejected] == [(Reason.REPEATED, 3)] * 2


def test_explain_reports_found_markers_and_names_failed_tests(
    ground,
) -> None:
    """Candidates in rendered markers and clutter, of any size and blur: a fit is good if and only if it fails
    no test, and nothing that is detected is among the rejections."""
    for seed in range(3):
        rng = np.random.default_rng(seed)
        renderer = Renderer(DICTIONARY, 1.0, ground, Sensor(4.0, rng), psf_px=rng.uniform(0.5, 1.5))
        side_px = rng.uniform(9, 30)
        places = (PLACES_PX - 199.5) / side_px * (1, -1)
        camera = Camera((400, 400), 10 * side_px)
        image = renderer.render(
            Shot(camera, CameraPose((0.0, 0.0), 10.0), np.array(IDS), places, rng.uniform(-3, 3, 4))
        )
        image = with_clutter(rng, image, 12)
        detector = PhotometricDetector(DICTIONARY, following=False)
        noise, distance = image_noise(image), code_distance(DICTIONARY)
        first, _ = detector.searches(image)
        tests = verification_tests(first.fits, noise, distance)
        failed = np.array([failed_test(tests, row) is not None for row in range(first.good.size)])
        assert not (failed & first.good).any()
        found = detector.detect(image)
        distances = np.abs(first.fits.homographies.centers[:, None] - found.centers_px @ [1, 1j])
        nearest = distances.min(axis=1, initial=np.inf)
        assert (failed | (nearest < 3)).all(), "what fails nothing is found, or lies where it is found"
        for r in explain(image, DICTIONARY, found):
            assert (np.linalg.norm(found.centers_px - r.center_px, axis=1) > side_px / 2).all()


def with_clutter(rng: np.random.Generator, image: np.ndarray, count: int) -> np.ndarray:
    """An image with dark quadrilaterals of 12 to 40 px between the markers."""
    image = image.copy()
    for _ in range(count):
        middle = rng.uniform(20, 380, 2)
        if np.abs(PLACES_PX - middle).max(axis=1).min() > 60:
            square = corners_of_pose([middle], [rng.uniform(0, 7)], [rng.uniform(12, 40)])[0]
            cv2.fillPoly(image, [np.rint(square * 16).astype(np.int32)], rng.uniform(10, 50), cv2.LINE_AA, 4)
    return image


@pytest.mark.parametrize("seed", [0, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (1, 2))])
def test_clutter_has_no_bits_and_is_counted(ground, seed) -> None:
    """Negative control: 30 dark quadrilaterals, none like a marker; those that are apart are counted."""
    rng = np.random.default_rng(seed)
    image = ground.draw(np.diag([20.0, 20, 1]), (400, 400))
    for _ in range(30):
        square = corners_of_pose([rng.uniform(20, 380, 2)], [rng.uniform(0, 7)], [rng.uniform(12, 40)])[0]
        cv2.fillPoly(image, [np.rint(square * 16).astype(np.int32)], rng.uniform(10, 50), cv2.LINE_AA, 4)
    noisy = cv2.GaussianBlur(image, (0, 0), 0.8) + rng.normal(0, 5, image.shape)
    image = np.clip(noisy, 0, 255).astype(np.uint8)
    rejected = explain(image, DICTIONARY)
    assert {r.reason for r in rejected} == {Reason.NO_BITS}
    assert 5 <= len(rejected) <= 30


def test_noise_is_not_explained() -> None:
    rng = np.random.default_rng(3)
    image = np.clip(rng.normal(128, 25, (400, 500)), 0, 255).astype(np.uint8)
    assert explain(image, DICTIONARY) == []


def test_another_dictionary_is_suggested(draw) -> None:
    image = draw(50, ids=[5, 60, 70, 99], dictionary="5X5_100")
    assert suggest(image, DICTIONARY) == "its markers are of another dictionary; try `dictionary=5X5_100`"
    assert suggest(draw(50), DICTIONARY) is None
    assert "mirrored" in (suggest(np.ascontiguousarray(draw(50)[:, ::-1]), DICTIONARY) or "")


def test_only_grey_images_are_explained() -> None:
    with pytest.raises(InputError, match="uint8"):
        explain(np.zeros((20, 20, 3), np.uint8), DICTIONARY)
    assert explain(np.zeros((3, 3), np.uint8), DICTIONARY) == []
