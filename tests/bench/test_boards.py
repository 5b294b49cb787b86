"""`skyherd bench boards`: on synthetic boards, errors match the simulated noise.

Corners are made directly, so that the truth is known: a board with its own errors, seen through a homography
and a lens, by detectors of given noise.
"""

import json
from dataclasses import replace

import cv2
import numpy as np
import pytest
from command_line import assert_refused, call
from PIL import Image

from skyherd.bench.boards.accuracy import RAYLEIGH_MEDIAN, collect_errors, covariance, find_floor, only
from skyherd.bench.boards.board_errors import MIN_IMAGES, BoardErrors, Fitted, learn_board_errors
from skyherd.bench.boards.board_fit import MAX_LEVERAGE, fit_board, robust_sigma
from skyherd.bench.boards.image_noise import immerkaer_noise
from skyherd.bench.boards.layout import BoardModel, board_corners
from skyherd.bench.boards.lens_degree import choose_degrees
from skyherd.bench.photographs.sightings import Sightings
from skyherd.geometry import apply_homography
from skyherd.markers.dictionary import load_dictionary

BOARD = BoardModel(kind="aprilgrid", columns=8, rows=6, gap=0.4)
CORNERS = board_corners(BOARD, "APRILTAG_36h11")
NOMINAL = np.array(list(CORNERS.values()))
IDS = np.array(list(CORNERS))
IMAGES = 12
CORNER_PX, MARKER_PX, HEADING_DEG = 0.05, 0.08, 0.2
K1 = -0.08


def lens(points_px):
    """Return radial distortion about (400, 300): 8 % at 400 px."""
    away = (points_px - [400.0, 300.0]) / 400.0
    return [400.0, 300.0] + 400.0 * away * (1 + K1 * (away**2).sum(axis=-1, keepdims=True))


def view(rng):
    """Return a homography that shows the whole board at 35 to 45 px per side."""
    turn, size = rng.uniform(-0.3, 0.3), rng.uniform(35, 45)
    similarity = size * np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    whole = np.eye(3)
    whole[:2, :2] = similarity
    whole[:2, 2] = [400, 300] - similarity @ NOMINAL.mean(axis=(0, 1))
    whole[2, :2] = rng.uniform(-0.01, 0.01, 2)
    return whole


def sightings(corners_px, ids=IDS, covariances=None):
    shape = np.zeros((len(ids), 3, 3)) if covariances is None else covariances
    return Sightings(ids, corners_px, shape, np.zeros(len(ids), dtype=np.int64))


def synthetic(detectors, *, board_error=0.0, shared_px=0.0, seed=1, images=IMAGES, degree=4):
    """Return fits of images, and the simulated board errors.

    Args:
        detectors: by name, functions of a random generator that give errors (K, 4, 2), px.
        board_error: standard deviation of the board's errors, marker sides.
        shared_px: standard deviation of an error of each marker that all detectors have, px.
        seed: seed of all random draws.
        images: number of images.
        degree: degree of the fitted polynomials.
    """
    rng = np.random.default_rng(seed)
    planted = rng.normal(0, board_error, NOMINAL.shape)
    fits = []
    for image in range(images):
        true = lens(apply_homography(view(rng), NOMINAL + planted))
        true = true + rng.normal(0, shared_px, (len(IDS), 1, 2))
        for name, noise in detectors.items():
            seen = sightings(true + noise(rng))
            fits.append(Fitted("s", image, name, fit_board(CORNERS, seen, degree)))
    return fits, planted


def of_corners(sigma):
    return lambda rng: rng.normal(0, sigma, NOMINAL.shape)


def of_markers(sigma):
    return lambda rng: np.broadcast_to(rng.normal(0, sigma, (len(IDS), 1, 2)), NOMINAL.shape)


def errors_of(fits, name, learned):
    return collect_errors([one for one in fits if one.detector == name], learned)


def nothing(images=IMAGES):
    """Return zero board errors."""
    shape = NOMINAL.shape
    return BoardErrors(np.zeros(shape), np.zeros((images, *shape)), np.zeros((len(IDS), 8, 8)))


@pytest.mark.parametrize("kind", ["corners", "markers"])
def test_left_out_error_matches_added_noise(kind):
    """Noise of single corners, or of whole markers: standardised residuals have its spread.

    576 markers: the standard error of a standard deviation from 1152 values is 2 %, and that of a median
    2.4 %; four of these are allowed. Unstandardised residuals are smaller, by 4 % with 15 terms for 192
    corners. Those of left-out markers, with the errors of the fit, are larger by as much.
    """
    noise = of_corners(CORNER_PX) if kind == "corners" else of_markers(MARKER_PX)
    fits, _ = synthetic({"one": noise})
    errors = errors_of(fits, "one", nothing())
    assert len(errors.keys) == IMAGES * len(IDS) and errors.outliers == 0
    sigma = CORNER_PX / 2 if kind == "corners" else MARKER_PX
    assert errors.center.std() == pytest.approx(sigma, rel=0.08)
    assert errors.median("center") == pytest.approx(RAYLEIGH_MEDIAN * sigma, rel=0.1)
    sigma = CORNER_PX if kind == "corners" else MARKER_PX
    assert errors.corner.std() == pytest.approx(sigma, rel=0.05)
    assert np.concatenate([one.fit.raw() for one in fits]).std() < 0.97 * errors.corner.std()
    assert np.concatenate([one.fit.left_out() for one in fits]).std() > 1.03 * errors.corner.std()


def test_left_out_residuals_match_refit():
    """The hat-matrix formula agrees with fits without the marker, to rounding."""
    fits, _ = synthetic({"one": of_corners(CORNER_PX)}, images=1)
    fit = fits[0].fit
    assert fit.fitted.all()
    for row in (0, 7, 20, 47):
        others = np.arange(len(IDS)) != row
        known = fit.basis[others].reshape(-1, fit.basis.shape[2])
        coefficients = np.linalg.lstsq(known, fit.residuals_px[others].reshape(-1, 2), rcond=None)[0]
        expected = fit.residuals_px[row] - fit.basis[row] @ coefficients
        np.testing.assert_allclose(fit.left_out()[row], expected, atol=1e-10)


def test_heading_errors_match_added_noise():
    def turned(rng):
        turns = np.radians(rng.normal(0, HEADING_DEG, len(IDS)))
        arms = 40 * (NOMINAL - NOMINAL.mean(axis=1, keepdims=True))
        return turns[:, None, None] * np.stack([-arms[..., 1], arms[..., 0]], axis=-1)

    fits, _ = synthetic({"one": turned})
    errors = errors_of(fits, "one", nothing())
    assert errors.heading.std() == pytest.approx(HEADING_DEG, rel=0.1)
    assert errors.center.std() < 0.2 * errors.corner.std()


def test_planted_board_errors_are_learned_and_removed():
    """Errors of 0.4 % of a side, 0.16 px, three times the noise: found except what polynomials explain.

    Without learning the errors are three times the noise. With it they equal the noise, also for the worse
    detector, and this number of images suffices.
    """
    detectors = {"fine": of_corners(CORNER_PX), "coarse": of_corners(4 * CORNER_PX)}
    fits, planted = synthetic(detectors, board_error=0.004)
    learned = learn_board_errors(fits, len(IDS), IMAGES)
    assert errors_of(fits, "fine", nothing()).corner.std() > 3 * CORNER_PX
    for name, sigma in (("fine", CORNER_PX), ("coarse", 4 * CORNER_PX)):
        errors = errors_of(fits, name, learned)
        assert errors.median("corner") == pytest.approx(RAYLEIGH_MEDIAN * sigma, rel=0.08)
        assert errors.median("center") == pytest.approx(RAYLEIGH_MEDIAN * sigma / 2, rel=0.12)
    basis = np.stack(
        [NOMINAL[..., 0] ** i * NOMINAL[..., 1] ** (k - i) for k in range(5) for i in range(k + 1)], -1
    )
    basis = basis.reshape(-1, basis.shape[2])
    left = [
        v - basis @ np.linalg.lstsq(basis, v, rcond=None)[0]
        for v in (planted.reshape(-1, 2), learned.displacements.reshape(-1, 2))
    ]
    assert np.corrcoef(left[0].ravel(), left[1].ravel())[0, 1] > 0.98


def test_perfect_board_has_no_learned_errors():
    """Negative control: δ is no larger than the noise of the mean of twelve images."""
    fits, _ = synthetic({"one": of_corners(CORNER_PX)})
    learned = learn_board_errors(fits, len(IDS), IMAGES)
    assert learned.displacements.std() < 1.2 * CORNER_PX / 40 / np.sqrt(IMAGES)
    assert errors_of(fits, "one", learned).median("corner") == pytest.approx(
        RAYLEIGH_MEDIAN * CORNER_PX, rel=0.08
    )
    few = [one for one in fits if one.image < MIN_IMAGES - 1]
    assert not learn_board_errors(few, len(IDS), MIN_IMAGES - 1).displacements.any()


def test_image_is_excluded_from_its_own_board_errors():
    """A marker is off by 0.2 px in one image: its residual keeps all of it, since the others lack it."""
    fits, _ = synthetic({"one": of_corners(1e-3)})
    fit = fits[3].fit
    moved = fit.residuals_px.copy()
    moved[10] += [0.2, 0.0]
    fits[3] = replace(fits[3], fit=replace(fit, residuals_px=moved))
    learned = learn_board_errors(fits, len(IDS), IMAGES)
    error = fits[3].fit.standardised(learned.without[3])[10].mean(axis=0)
    np.testing.assert_allclose(error, [0.2, 0.0], atol=0.03)
    assert np.abs(learned.displacements[10, :, 0] * 40).mean() > 0.01


def test_floor_is_common_error_of_two_detectors():
    """Each marker is displaced for all detectors by 0.08 px; without it there is no floor."""
    detectors = {"locus-tag": of_corners(CORNER_PX), "apriltag3": of_corners(2 * CORNER_PX)}
    for shared, expected in ((MARKER_PX, MARKER_PX), (0.0, 0.0)):
        fits, _ = synthetic(detectors, shared_px=shared)
        errors = {name: errors_of(fits, name, nothing()) for name in detectors}
        floor = find_floor(errors, {}, 0.0)["center"]
        assert floor == pytest.approx(expected, abs=0.018)
    assert find_floor({"opencv": errors["locus-tag"], "opencv-subpix": errors["apriltag3"]}, {}, 0.0) == {
        "center": None, "corner": None, "heading": None,
    }  # fmt: skip


def test_common_noise_is_not_part_of_floor():
    """Half of the shared variance is attributed to the image's noise: the other half remains."""
    detectors = {"locus-tag": of_corners(CORNER_PX), "apriltag3": of_corners(CORNER_PX)}
    fits, _ = synthetic(detectors, shared_px=MARKER_PX)
    errors = {name: errors_of(fits, name, nothing()) for name in detectors}
    shared = covariance(errors["locus-tag"], errors["apriltag3"], "center")
    shifts = {name: replace(one, center=np.ones_like(one.center)) for name, one in errors.items()}
    of_shifts = covariance(shifts["locus-tag"], shifts["apriltag3"], "center")
    floor = find_floor(errors, shifts, shared / of_shifts / 2)["center"]
    assert floor == pytest.approx(np.sqrt(shared / 2))


def test_nees_is_one_for_consistent_covariance_and_floor():
    rng = np.random.default_rng(5)
    fits = []
    right = np.zeros((len(IDS), 3, 3))
    right[:] = np.diag([CORNER_PX**2 / 4, CORNER_PX**2 / 4, 1.0])
    for image in range(IMAGES):
        true = lens(apply_homography(view(rng), NOMINAL))
        seen = sightings(true + rng.normal(0, CORNER_PX, NOMINAL.shape), covariances=right)
        fits.append(Fitted("s", image, "one", fit_board(CORNERS, seen, 4)))
    errors = errors_of(fits, "one", nothing())
    assert errors.nees("center", 0.0) == pytest.approx(1.0, abs=0.15)
    assert errors.nees("center", CORNER_PX / 2) == pytest.approx(0.5, abs=0.08)
    assert replace(errors, covariances=0 * errors.covariances).nees("center", 0.0) is None


def test_wrong_id_is_outlier_without_effect():
    rng = np.random.default_rng(2)
    true = lens(apply_homography(view(rng), NOMINAL)) + rng.normal(0, CORNER_PX, NOMINAL.shape)
    ids = IDS.copy()
    ids[[4, 30]] = ids[[30, 4]]
    fit = fit_board(CORNERS, sightings(true, ids), 4)
    assert set(fit.ids[~fit.fitted].tolist()) == {4, 30}
    assert robust_sigma(fit.standardised()) == pytest.approx(CORNER_PX, rel=0.2)
    assert np.abs(fit.standardised()[4]).max() > 100


def test_too_few_markers_give_no_fit():
    rng = np.random.default_rng(2)
    true = apply_homography(view(rng), NOMINAL)
    assert fit_board(CORNERS, sightings(true[:4], IDS[:4]), 3) is None
    assert fit_board(CORNERS, sightings(true, IDS + 200), 3) is None
    assert fit_board(CORNERS, sightings(np.zeros((0, 4, 2)), np.zeros(0, dtype=np.int64)), 3) is None
    twice = np.concatenate([IDS, IDS[:3]])
    fit = fit_board(CORNERS, sightings(np.concatenate([true, true[:3]]), twice), 3)
    assert fit.ids.tolist() == IDS[3:].tolist(), "of repeated ids none counts"


def test_undetermined_marker_is_not_evaluated():
    """A single remote marker determines the polynomials there."""
    rng = np.random.default_rng(2)
    near = np.arange(len(IDS)) % 8 < 2
    keep = near | (IDS == 47)
    true = apply_homography(view(rng), NOMINAL) + rng.normal(0, CORNER_PX, NOMINAL.shape)
    fit = fit_board(CORNERS, sightings(true[keep], IDS[keep]), 4)
    values = np.linalg.eigvalsh(fit.basis @ fit.basis.swapaxes(1, 2)).max(axis=1)
    assert values[-1] > MAX_LEVERAGE and np.isnan(fit.standardised()[-1]).all()
    assert np.isfinite(fit.standardised()[:-1]).all()


def test_chosen_degree_matches_lens():
    """A lens of third degree needs at least three; without a lens two suffice."""
    rng = np.random.default_rng(3)
    shapes = [apply_homography(view(rng), NOMINAL) for _ in range(4)]
    noise = [rng.normal(0, CORNER_PX, NOMINAL.shape) for _ in shapes]
    flat = [{"one": sightings(shape + error)} for shape, error in zip(shapes, noise, strict=True)]
    bent = [{"one": sightings(lens(shape) + error)} for shape, error in zip(shapes, noise, strict=True)]
    assert choose_degrees(CORNERS, {"flat": flat, "none": []}) == {"flat": 2, "none": 2}
    assert choose_degrees(CORNERS, {"bent": bent})["bent"] >= 3


def test_jacobians_match_whole_map():
    fits, _ = synthetic({"one": of_corners(0.0)}, images=1)
    rng = np.random.default_rng(1)
    rng.normal(0, 0.0, NOMINAL.shape)
    homography, step = view(rng), 1e-4
    for axis in range(2):
        shift = step * np.eye(2)[axis]
        ends = [lens(apply_homography(homography, NOMINAL + way * shift)) for way in (1, -1)]
        expected = (ends[0] - ends[1]) / (2 * step)
        np.testing.assert_allclose(fits[0].fit.jacobians[..., axis], expected, atol=0.05)


def test_layouts_match_opencv_and_kalibr():
    """A ChArUco board and a grid as OpenCV draws them; AprilGrid ids begin at the lower left."""
    for legacy in (False, True):
        model = BoardModel(kind="charuco", columns=5, rows=4, marker=0.6, legacy=legacy)
        board = cv2.aruco.CharucoBoard((5, 4), 1.0, 0.6, load_dictionary("4X4_50"))
        board.setLegacyPattern(legacy)
        drawn = board.generateImage((1000, 800))
        corners, ids, _ = cv2.aruco.ArucoDetector(load_dictionary("4X4_50")).detectMarkers(drawn)
        assert len(ids) == 10
        found = {
            int(i[0]): np.reshape(c, (4, 2)) for i, c in zip(np.reshape(ids, (-1, 1)), corners, strict=True)
        }
        for marker_id, nominal in board_corners(model, "4X4_50").items():
            np.testing.assert_allclose(found[marker_id], nominal * 120 - 0.5, atol=1.6)
    grid = board_corners(BoardModel(kind="aruco", columns=3, rows=2, gap=0.5, first_id=7), "4X4_50")
    assert list(grid) == [7, 8, 9, 10, 11, 12]
    np.testing.assert_array_equal(grid[7], [[0, 0], [1, 0], [1, 1], [0, 1]])
    np.testing.assert_array_equal(grid[11][0], [1.5, 1.5])
    kalibr = board_corners(BoardModel(kind="aprilgrid", columns=3, rows=2, gap=0.5), "APRILTAG_36h11")
    np.testing.assert_array_equal(kalibr[0], [[1, 2.5], [0, 2.5], [0, 1.5], [1, 1.5]])
    np.testing.assert_array_equal(kalibr[5].min(axis=0), [3.0, 0.0])


def test_immerkaer_noise_ignores_picture_content():
    rng = np.random.default_rng(4)
    shade = np.add.outer(np.linspace(50, 120, 300), np.linspace(0, 60, 400))
    noisy = shade + rng.normal(0, 4.0, shade.shape)
    assert immerkaer_noise(np.rint(noisy).astype(np.uint8)) == pytest.approx(4.0, rel=0.04)
    assert immerkaer_noise(np.rint(shade).astype(np.uint8)) < 0.6


def test_only_keeps_named_markers():
    fits, _ = synthetic({"one": of_corners(CORNER_PX)}, images=2)
    errors = errors_of(fits, "one", nothing(2))
    kept = only(errors, {(0, 3), (1, 5), (7, 5)})
    assert kept.keys.tolist() == [[0, 3], [1, 5]] and kept.center.shape == (2, 2)


@pytest.fixture
def photographed(tmp_path):
    """Return three photographs of a grid of markers, warped and noisy, with their sets."""
    folder = tmp_path / "images"
    folder.mkdir()
    board = cv2.aruco.GridBoard((5, 4), 1.0, 0.5, load_dictionary("4X4_50"))
    drawn = board.generateImage((580, 460), marginSize=10)
    rng = np.random.default_rng(6)
    for number in range(3):
        corners = np.array([[0, 0], [580, 0], [580, 460], [0, 460]], np.float32)
        seen = (corners * 0.8 + 40 + rng.uniform(-20, 20, (4, 2))).astype(np.float32)
        warp = cv2.getPerspectiveTransform(corners, seen)
        image = cv2.warpPerspective(drawn, warp, (560, 460), flags=cv2.INTER_AREA, borderValue=255)
        image = cv2.GaussianBlur(image, (0, 0), 0.8) * 0.7 + 30 + rng.normal(0, 2, image.shape)
        Image.fromarray(np.clip(np.rint(image), 0, 255).astype(np.uint8)).save(folder / f"{number}.png")
    (folder / "photographs.toml").write_text(
        "[grid]\nfiles = ['*.png']\ndictionary = '4X4_50'\n"
        "[grid.board]\nkind = 'aruco'\ncolumns = 5\nrows = 4\ngap = 0.5\ndegree = 3\n"
    )
    return folder


def test_command_writes_all_outputs(photographed, tmp_path, capsys):
    out = tmp_path / "out"
    arguments = ("--detector", "opencv,photometric", "--out", out)
    code, said, err = call(capsys, "bench", "boards", photographed, *arguments)
    assert code == 0, err
    assert "photometric" in said and str(out / "boards.html") in said
    result = json.loads((out / "boards.json").read_text())
    rows = {row["detector"]: row for row in result["rows"]}
    assert list(rows) == ["opencv", "photometric"]
    ours, opencv = rows["photometric"], rows["opencv"]
    assert ours["recall"] == opencv["recall"] == 1.0 and ours["markers"] == ours["found"] == 60
    assert ours["center_px"] < 0.03 < opencv["center_px"] < 0.5
    assert ours["nees_center"] is not None and opencv["nees_center"] is None
    assert ours["center_floor_px"] < 0.05
    page = (out / "boards.html").read_text()
    assert page.count("data:image/png") == 3 and "Beyond the floor" in page
    assert (out / "boards.md").read_text().count("###") == 7


def test_missing_and_invalid_boards_are_rejected(photographed, capsys, tmp_path):
    path = photographed / "photographs.toml"
    text = path.read_text()
    for wrong, word in (("kind = 'round'", "board.kind"), ("kind = 'aruco'\nrows = 0", "board.rows")):
        path.write_text(text.replace("kind = 'aruco'", wrong).replace("\nrows = 4", "", "rows = 0" in wrong))
        assert_refused(call(capsys, "bench", "boards", photographed, "--out", tmp_path / "out"), word)
    path.write_text(text.split("[grid.board]")[0])
    assert_refused(call(capsys, "bench", "boards", photographed, "--out", tmp_path / "out"), "has a board")
