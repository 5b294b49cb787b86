"""Each reason on an image that has exactly that fault, and none on the same image without it."""

from collections.abc import Callable

import cv2
import numpy as np
import pytest

from skyherd.errors import InputError
from skyherd.markers.dictionary import corners_of_pose, marker_cells
from skyherd.render import Camera, CameraPose, Ground, Renderer, Sensor
from skyherd.vision import create_detector
from skyherd.vision.diagnosis.explain import Rejection, explain
from skyherd.vision.diagnosis.quad_reading import load_templates, read_quad
from skyherd.vision.diagnosis.reasons import ENOUGH_CELL_PX, Reason
from skyherd.vision.diagnosis.suggestions import suggest

DICTIONARY = "4X4_50"
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
        return renderer.render(camera, pose, np.array(ids), places[: len(ids)], headings)

    return make


def likely(image: np.ndarray, dictionary: str = DICTIONARY) -> list[Rejection]:
    return [r for r in explain(image, dictionary) if r.reason is not Reason.NO_BITS]


def blindly(image: np.ndarray) -> list[Rejection]:
    """As for a detector that finds nothing: what is said does not hang on how good today's is."""
    nothing = create_detector(dictionary=DICTIONARY).detect(image).select([])
    return [r for r in explain(image, DICTIONARY, nothing) if r.reason is not Reason.NO_BITS]


def explained_at(image: np.ndarray, place_px: np.ndarray) -> Rejection:
    """The one rejection within 10 px of a place."""
    near = [r for r in likely(image) if np.linalg.norm(r.center_px - place_px) < 10]
    assert len(near) == 1, [(r.reason, r.center_px) for r in near]
    return near[0]


def test_nothing_is_rejected_where_all_is_well(draw) -> None:
    """The control of all below: the same picture without a fault."""
    image = draw()
    assert create_detector(dictionary=DICTIONARY).detect(image).ids.tolist() == IDS
    assert likely(image) == []
    assert {(r.reason, r.reading.nearest_id) for r in blindly(image)} == {(Reason.OVERLOOKED, k) for k in IDS}


def test_too_few_pixels(draw) -> None:
    """Markers of 9 px have 1.5 px a cell; an outline is right to two pixels a side, a third of one a cell."""
    rejected = blindly(draw(9))
    assert len(rejected) >= 3
    for r in rejected:
        assert r.reason is Reason.FEW_PIXELS
        assert r.reading.cell_px[0] == pytest.approx(1.5, abs=0.34)
        assert f"{r.reading.cell_px[0]:.1f} px a cell, at least 3" in r.words and "fly lower" in r.words
    assert {r.reading.nearest_id for r in rejected} <= set(IDS)


def test_low_contrast(draw) -> None:
    """25 grey levels, measured to the noise of a mean over a cell, and texture: within 5."""
    rejected = blindly(draw(black=112.0, white=137.0))
    assert {r.reading.nearest_id for r in rejected} == set(IDS)
    for r in rejected:
        assert r.reason is Reason.LOW_CONTRAST and r.reading.contrast == pytest.approx(25, abs=5)
        assert "at least 40" in r.words


FEW_OR_ALL = pytest.mark.parametrize("count", [2, pytest.param(4, marks=pytest.mark.slow)])
"""How many of the markers are in the picture."""


@FEW_OR_ALL
@pytest.mark.parametrize("psf_px", [5.5, pytest.param(4.5, marks=pytest.mark.slow)])
def test_too_blurred(draw, psf_px, count) -> None:
    """Cells of 6.7 px under 4.5 px and more; blurs are tried in steps of 0.1 to 0.15 of a cell."""
    rejected = blindly(draw(psf_px=psf_px, ids=IDS[:count]))
    assert len(rejected) >= count / 2
    for r in rejected:
        assert r.reason is Reason.BLURRED, r.words
        assert r.reading.blur_cells == pytest.approx(psf_px / (40 / 6), abs=0.15)
        assert "focus" in r.words


@FEW_OR_ALL
def test_no_quiet_zone(count) -> None:
    """Cut out along the black and laid on black: the outline cannot be seen, the bits can."""
    rng = np.random.default_rng(0)
    ids, places_px = IDS[:count], PLACES_PX[:count]
    image = np.full((400, 400), 35, np.uint8)
    for marker_id, (u, v) in zip(ids, places_px.astype(int), strict=True):
        marker = np.where(marker_cells(DICTIONARY, marker_id), 230, 30).astype(np.uint8)
        marker = cv2.resize(marker, (60, 60), interpolation=cv2.INTER_NEAREST)
        image[v - 30 : v + 30, u - 30 : u + 30] = marker
    turn = cv2.getRotationMatrix2D((200, 200), 20, 1.0)
    image = cv2.GaussianBlur(cv2.warpAffine(image, turn, (400, 400), borderValue=35), (0, 0), 0.8)
    image = np.clip(image + rng.normal(0, 2, image.shape), 0, 255).astype(np.uint8)
    rejected = blindly(image)
    assert {r.reading.nearest_id for r in rejected} == set(ids)
    for r in rejected:
        assert r.reason is Reason.NO_QUIET_ZONE and "4 of its 4 edges" in r.words
        wanted = (places_px[ids.index(r.reading.nearest_id)] - 0.5) @ turn[:, :2].T + turn[:, 2]
        np.testing.assert_allclose(r.center_px, wanted, atol=2)


@pytest.mark.parametrize("cut", [slice(105, 400), pytest.param(slice(96, 400), marks=pytest.mark.slow)])
def test_cut_by_the_border(draw, cut) -> None:
    """The left of the picture cut off through two markers; the share left is right to a row of cells."""
    whole = draw(60)
    image = np.ascontiguousarray(whole[:, cut])
    rejected = [r for r in blindly(image) if r.reason is not Reason.OVERLOOKED]
    assert [r.reason for r in rejected] == [Reason.CUT] * 2
    share = 0.5 + (PLACES_PX[0, 0] - cut.start) / 60
    for r in rejected:
        assert np.abs(r.center_px[0] + cut.start - PLACES_PX[0, 0]) < 4
        assert r.reading.visible == pytest.approx(share, abs=1 / 6)
        assert "in the picture" in r.words


def test_a_shape_without_bits_at_the_border_is_not_called_a_marker(draw) -> None:
    image = draw(60)
    image[150:200, :40] = 25
    assert likely(image) == []


def test_too_oblique(draw) -> None:
    """Seen at acos(0.2) = 78.5 deg, 60 px become 12, 2 px a cell the short way.

    OpenCV still reads them without noise; a detector that does not is told this.
    """
    image = cv2.resize(draw(60, noise=0.0), (400, 80), interpolation=cv2.INTER_AREA)
    rejected = blindly(image)
    assert {(r.reason, r.reading.nearest_id) for r in rejected} == {(Reason.OBLIQUE, k) for k in IDS}
    for r in rejected:
        assert r.reading.tilt_deg == pytest.approx(78.5, abs=4)
        assert r.reading.cell_px[0] < ENOUGH_CELL_PX < r.reading.cell_px[1]


def test_wrong_bits_and_how_many(draw) -> None:
    """Two white cells of id 3 painted over: it is still most like id 3, and more than can be corrected."""
    dictionary_id, place = 3, PLACES_PX[0]
    image = draw(60)
    cells = np.argwhere(marker_cells(DICTIONARY, dictionary_id))[:2]
    ahead = np.array([np.cos(0.3), np.sin(0.3)])
    right = np.array([-ahead[1], ahead[0]])
    for row, column in cells:
        middle = place + 60 * ((0.5 - (row + 0.5) / 6) * ahead + ((column + 0.5) / 6 - 0.5) * right)
        square = corners_of_pose([middle], [0.3], [10.5])[0]
        cv2.fillPoly(image, [np.rint(square * 16).astype(np.int32)], 30, cv2.LINE_AA, 4)
    (r,) = likely(image)
    assert np.linalg.norm(r.center_px - place) < 10
    assert (r.reason, r.reading.nearest_id, r.reading.wrong_bits) == (Reason.WRONG_BITS, 3, 2)
    assert "2 of 36 cells" in r.words and "id 3" in r.words


def test_a_corner_that_is_covered(draw) -> None:
    image = draw(60)
    cv2.circle(image, (80, 85), 17, 205, -1, cv2.LINE_AA)
    r = explained_at(image, PLACES_PX[0])
    assert r.reason is Reason.WRONG_BITS and r.reading.nearest_id == 3 and "covered" in r.words


@FEW_OR_ALL
def test_mirrored(draw, count) -> None:
    ids = IDS[:count]
    rejected = likely(np.ascontiguousarray(draw(ids=ids)[:, ::-1]))
    assert {(r.reason, r.reading.nearest_id) for r in rejected} == {(Reason.MIRRORED, k) for k in ids}


def test_an_id_that_is_there_twice(draw) -> None:
    rejected = likely(draw(ids=[3, 7, 3, 21]))
    assert [(r.reason, r.reading.nearest_id) for r in rejected] == [(Reason.REPEATED, 3)] * 2


def test_what_reads_well_and_was_not_reported_is_overlooked(draw) -> None:
    """A detector that has lost one: its detections are handed in without it."""
    image = draw()
    found = create_detector(dictionary=DICTIONARY).detect(image).select([3, 7, 12])
    rejected = [r for r in explain(image, DICTIONARY, found) if r.reason is not Reason.NO_BITS]
    assert [(r.reason, r.reading.nearest_id) for r in rejected] == [(Reason.OVERLOOKED, 21)]
    assert "without a fault" in rejected[0].words


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
    assert suggest(image, DICTIONARY) == "its markers are of another dictionary; try --dictionary 5X5_100"
    assert suggest(draw(50), DICTIONARY) is None
    assert "mirrored" in (suggest(np.ascontiguousarray(draw(50)[:, ::-1]), DICTIONARY) or "")


def test_a_drawn_marker_is_read_with_its_levels_and_blur() -> None:
    """Blurred by a Gaussian of 0.4 cells: likeness 1 but for sampling, its levels, and that blur."""
    cells = np.pad(np.where(marker_cells(DICTIONARY, 17), 200, 40), 2, constant_values=200).astype(np.uint8)
    image = cv2.GaussianBlur(np.kron(cells, np.ones((20, 20), np.uint8)), (0, 0), 8.0)
    corners = np.array([[40, 40], [160, 40], [160, 160], [40, 160]]) - 0.5
    reading = read_quad(image, corners, DICTIONARY)
    assert reading.nearest_id == 17 and reading.wrong_bits <= 1 and reading.likeness > 0.999
    assert (reading.black, reading.white) == (pytest.approx(40, abs=3), pytest.approx(200, abs=3))
    assert reading.blur_cells == pytest.approx(0.4) and reading.cell_px.tolist() == pytest.approx([20, 20])


def test_templates_hold_every_turn_and_the_mirror_image() -> None:
    templates = load_templates(DICTIONARY)
    assert templates.white.shape == (400, 6, 6)
    np.testing.assert_array_equal(templates.white[2 * 50 + 9], np.rot90(marker_cells(DICTIONARY, 9), 2))
    assert templates.row(4 * 50 + 11) == (11, True)
    np.testing.assert_array_equal(templates.white[4 * 50 + 11], marker_cells(DICTIONARY, 11)[:, ::-1])


def test_only_grey_images_are_explained() -> None:
    with pytest.raises(InputError, match="uint8"):
        explain(np.zeros((20, 20, 3), np.uint8), DICTIONARY)
    assert explain(np.zeros((3, 3), np.uint8), DICTIONARY) == []
