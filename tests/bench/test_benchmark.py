"""`skyherd bench detectors`: cells and frames, a user's detector, outputs, and rejected input."""

import json
import sys
from dataclasses import replace
from functools import cache
from importlib.util import module_from_spec, spec_from_file_location
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from skyherd.bench.detectors.design import CAMERA_SWEEPS, EMPTY, GRID, SWEEPS, Cell, full_design, quick_design
from skyherd.bench.detectors.frames import lens_blur, rendered_frames, shrunk
from skyherd.bench.detectors.page import MARKDOWN, PAGE, write_outputs
from skyherd.bench.detectors.plots import PLOTS
from skyherd.bench.detectors.scene import SPEED_PX, TURN_RAD, camera_shots
from skyherd.bench.detectors.tables import make_tables
from skyherd.bench.detectors.timing import WARM_UP, measure_times, timing_cells
from skyherd.bench.entrants import EntrantError, default_entrants, dictionary_for, make_entrant
from skyherd.bench.execution import Plan, measure_cells
from skyherd.bench.result import RESULT, Result, environment, read_result
from skyherd.bench.table import share, short
from skyherd.cli import main
from skyherd.errors import InputError
from skyherd.geometry import wrap_angle

ROW_KEYS = {
    "detector", "side_px", "noise", "blur_px", "tilt_deg", "recall", "false_positives_per_image", "bias_px",
    "rmse_px", "rmse_deg", "crb_px", "crb_deg", "nees", "ms_median", "ms_p99",
    "motion_px", "contrast", "uneven", "occlusion", "clutter", "dictionary", "ratio_px", "ratio_deg",
}  # fmt: skip

STRANGER = '''
from skyherd.vision import create_detector


class Shy:
    """Sees nothing in odd frames."""

    def __init__(self, dictionary):
        self._detector, self._frames = create_detector(dictionary=dictionary), 0

    def detect(self, image, *, time_s=0.0, unit_id=0):
        self._frames += 1
        seen = self._detector.detect(image, time_s=time_s, unit_id=unit_id)
        return seen if self._frames % 2 else seen.select([])


class Broken(Shy):
    def detect(self, image, *, time_s=0.0, unit_id=0):
        raise ZeroDivisionError("no luck")
'''


def make_frames(cell, seed=3, dictionary="4X4_50"):
    return list(rendered_frames(replace(cell, cameras=2, frames=2), dictionary, seed))


frames = cache(make_frames)
"""Return the same frames, made once for all tests."""


def test_design_varies_one_factor_at_a_time():
    """In a sweep one factor differs from the base cell, in the grid only side and noise."""
    cells = full_design()
    base = cells[0]
    assert base == Cell()
    assert {(c.side_px, c.noise) for c in cells if c.sweep == GRID} >= {
        (8.0, 2.0),
        (30.0, 5.0),
        (100.0, 10.0),
    }
    for sweep in (*SWEEPS, *CAMERA_SWEEPS):
        swept = [cell for cell in cells if cell.sweep == sweep.name]
        assert [getattr(cell, sweep.key) for cell in swept] == list(sweep.values)
        for cell in swept:
            held = {key: getattr(base, key) for key in (sweep.key, *sweep.fixed)}
            assert replace(cell, sweep="base", **held) == base
            assert {key: getattr(cell, key) for key in sweep.fixed} == dict(sweep.fixed)
    assert {cell.sweep for cell in quick_design()} == {cell.sweep for cell in cells}
    assert [cell.clutter for cell in full_design(0) if cell.sweep == EMPTY] == []


def test_camera_blurs_cover_range():
    cell = Cell()
    blurs = [cell.blur_of(camera) for camera in range(cell.cameras)]
    assert 0.5 < min(blurs) < 0.6 and 1.4 < max(blurs) < 1.5
    assert np.mean(blurs) == pytest.approx(1.0)
    assert replace(cell, blur_px=0.7).blur_of(2) == 0.7


def test_frames_depend_on_seed_only():
    one, same, other = frames(Cell()), make_frames(Cell()), frames(Cell(), seed=4)
    for a, b in zip(one, same, strict=True):
        np.testing.assert_array_equal(a.image, b.image)
        np.testing.assert_array_equal(a.bounds, b.bounds)
    assert not np.array_equal(one[0].image, other[0].image)


def test_dictionary_changes_only_bits():
    for a, b in zip(frames(Cell()), frames(Cell(), dictionary="APRILTAG_36h11"), strict=True):
        np.testing.assert_array_equal(a.ids, b.ids)
        np.testing.assert_allclose(a.headings_rad, b.headings_rad)
        np.testing.assert_allclose(a.sides_px, b.sides_px)
        assert not np.array_equal(a.image, b.image)


@pytest.mark.parametrize(
    "cell",
    [Cell(), Cell(side_px=100.0), Cell(side_px=8.0), Cell(tilt_deg=30.0), Cell(touching=0.5)],
)
def test_markers_are_whole_apart_and_of_given_size(cell):
    """Sides match the cell to 0.1 % seen from above; under tilt only at the image's centre."""
    for frame in frames(cell):
        assert frame.whole.all()
        assert len(frame.ids) == 16 if cell.tilt_deg == 0 else len(frame.ids) >= 4
        height, width = frame.image.shape
        assert (width, height) == cell.size_px
        rel = 1e-3 if cell.tilt_deg == 0 else 0.35
        assert frame.sides_px.mean() == pytest.approx(cell.side_px, rel=rel)
        gaps = np.linalg.norm(frame.centers_px[:, None] - frame.centers_px[None], axis=2)
        assert gaps[~np.eye(len(gaps), dtype=bool)].min() > 1.4 * cell.side_px


def test_marker_motion_is_trackable():
    shown = frames(Cell())
    for before, after in pairwise(shown[:2]):
        step = np.linalg.norm(after.centers_px - before.centers_px, axis=1)
        assert step.min() > 0 and step.max() < 1.5 * SPEED_PX
        turn = np.abs(wrap_angle(after.headings_rad - before.headings_rad))
        assert turn.max() <= TURN_RAD + 1e-9
        assert after.time_s > before.time_s and after.unit_id == before.unit_id


@cache
def first_frame(cell):
    """Return the first frame of a cell's first camera."""
    return next(rendered_frames(replace(cell, cameras=1, frames=1), "4X4_50", 3))


def frame_of(**factors):
    """Return noise-free first frames of a cell with these factors, and of one without them."""
    cell = Cell(noise=0.01, blur_px=0.8)
    return [first_frame(c) for c in (replace(cell, **factors), cell)]


def test_motion_blur_widens_bound_and_smooths_image():
    """An edge's variance grows as its blur: sqrt(1 + 16 / 24 / 0.72) = 1.39; edges along it stay sharp."""
    moved, still = frame_of(motion_px=4.0)
    np.testing.assert_allclose(moved.centers_px, still.centers_px)
    steep = [np.mean(np.square(np.gradient(frame.image.astype(float)))) for frame in (moved, still)]
    assert steep[0] < 0.8 * steep[1]
    assert (np.einsum("nii->ni", moved.bounds) > 1.3 * np.einsum("nii->ni", still.bounds)).all()


def test_uneven_light_spans_share_without_saturation():
    """Light from 0.7 to 1.3 of its mean: ground grey follows it, and bounds its square."""
    uneven, even = frame_of(uneven=0.6)
    assert uneven.image.max() < 250
    ratio = uneven.image / even.image.astype(float)
    assert np.percentile(ratio, 99.9) / np.percentile(ratio, 0.1) == pytest.approx(1.3 / 0.7, rel=0.1)
    light = np.sqrt(even.bounds[:, 0, 0] / uneven.bounds[:, 0, 0])
    at = np.rint(even.centers_px).astype(int)
    around = [np.median(ratio[v - 10 : v + 10, u - 10 : u + 10]) for u, v in at]
    np.testing.assert_allclose(light, around, rtol=0.05)


@pytest.mark.parametrize("tilt_deg", [60.0, 70.0])
def test_steep_tilt_shows_no_horizon(tilt_deg):
    """All markers are whole, drawn (white card round black square), and of about the given size."""
    for frame in frames(Cell(tilt_deg=tilt_deg)):
        assert frame.whole.all() and len(frame.ids) >= 4
        assert frame.sides_px.mean() == pytest.approx(30.0, rel=0.35) and (frame.sides_px > 10).all()
        assert (np.einsum("nii->ni", frame.bounds) > 0).all() and np.isfinite(frame.bounds).all()
        assert (frame.image > 200).mean() > 0.4 * (frame.sides_px**2).sum() / frame.image.size


def test_touching_squares_lie_at_card_corners():
    """Black at the squares' centres, white beside the middles of the marker's edges."""
    touched, _ = frame_of(touching=0.3)
    assert touched.whole.all()
    y, x = np.mgrid[: touched.image.shape[0], : touched.image.shape[1]]
    for (u, v), heading, side in zip(touched.centers_px, touched.headings_rad, touched.sides_px, strict=True):
        at = ((x - u) + 1j * (y - v)) * np.exp(-1j * heading) / side
        far, near = (f(np.abs(at.real), np.abs(at.imag)) for f in (np.maximum, np.minimum))
        squares = (np.abs(far - 0.65) < 0.06) & (np.abs(near - 0.65) < 0.06)
        beside = (np.abs(far - 0.58) < 0.02) & (near < 0.3)
        assert squares.sum() >= 4 and touched.image[squares].max() < 40
        assert beside.sum() >= 20 and touched.image[beside].min() > 180


def test_drawing_has_two_grey_levels_except_edges():
    """30 and 230; only pixels on an edge, a few per cent, lie between."""
    drawing = next(
        rendered_frames(Cell(noise=0.0, blur_px=0.0, plain=True, cameras=1, frames=1), "4X4_50", 3)
    )
    assert np.isin(drawing.image, (30, 230)).mean() > 0.97
    assert {30, 230} <= set(np.unique(drawing.image).tolist())


@pytest.mark.parametrize(
    "factors",
    [
        {"disc_px": 2.0},
        {"coma_px": 1.0},
        {"gamma": 2.0},
        {"white_balance": 2.0},
        {"denoise": 10.0},
        {"sharpen": 1.0},
        {"jpeg": 50},
        {"h264": 30},
    ],
)
def test_lens_and_processing_keep_scene(factors):
    """The bound is that of the raw pixels: it depends only on the lens's blur and the filters."""
    cell = Cell(noise=2.0, blur_px=0.6)
    changed, plain = (first_frame(c) for c in (replace(cell, **factors), cell))
    np.testing.assert_array_equal(changed.centers_px, plain.centers_px)
    assert (changed.image != plain.image).mean() > 0.2
    grown = np.einsum("nii->ni", changed.bounds) / np.einsum("nii->ni", plain.bounds)
    raw = {"disc_px", "coma_px", "white_balance"} & set(factors)
    assert (grown > 1.2).all() if raw else np.array_equal(grown, np.ones_like(grown))


def test_defocus_is_sharp_in_centre_and_disc_in_corner():
    """At 25 deg of tilt; the image's blur is that of the renderer's thin lens."""
    cell = Cell(tilt_deg=25.0, defocus_px=2.5, cameras=1, frames=1)
    shot = next(camera_shots(cell, "4X4_50", 0, np.random.default_rng(1)))
    blur = lens_blur(cell, shot)
    middle = blur.radii_px(shot.camera, shot.pose, np.array(shot.camera.size_px) / 2 - 0.5)
    corners = blur.radii_px(shot.camera, shot.pose, shot.camera.corners_px)
    assert middle == pytest.approx(0.0, abs=1e-9)
    assert np.abs(corners).max() == pytest.approx(2.5)


@pytest.mark.parametrize("share", [0.02, 0.1])
def test_occlusion_covers_given_share(share):
    """Share of pixels that differ from the uncovered image; the disc's blurred rim adds up to 0.05."""
    covered, bare = frame_of(occlusion=share)
    assert covered.whole.all()
    for (u, v), heading, side in zip(bare.centers_px, bare.headings_rad, bare.sides_px, strict=True):
        y, x = np.mgrid[: bare.image.shape[0], : bare.image.shape[1]]
        turned = ((x - u) + 1j * (y - v)) * np.exp(-1j * heading)
        inside = (np.abs(turned.real) < side / 2) & (np.abs(turned.imag) < side / 2)
        changed = covered.image[inside] != bare.image[inside]
        assert changed.mean() == pytest.approx(share, abs=0.05)


def test_clutter_has_given_number_of_quads():
    """Dark area: 150 of mean side 0.8 x 30 px cover at most 150 x 600 px of 307200."""
    cluttered, bare = frame_of(clutter=150, markers=0)
    assert len(cluttered.ids) == 0 and cluttered.bounds.shape == (0, 3, 3)
    dark = (cluttered.image < 70).mean()
    expected = 1 - np.exp(-150 * 30.0**2 * 0.7 / 307200)
    assert (bare.image < 70).mean() < 0.06
    assert dark == pytest.approx(expected, rel=0.35)


@pytest.mark.parametrize("cell", [Cell(noise=0.01, blur_px=0.8), Cell(noise=0.01, tilt_deg=15.0)])
def test_reference_frames_show_same_scenes(cell, monkeypatch):
    """Truth and bounds agree to the last digit, images on markers to a grey level of rounding."""
    path = Path(__file__).parents[2] / "benchmarks" / "detectors_on_reference.py"
    spec = spec_from_file_location("on_reference", path)
    module = module_from_spec(spec)
    spec.loader.exec_module(module)
    cell = replace(cell, cameras=1, frames=1)
    ours, theirs = (next(source(cell, "4X4_50", 3)) for source in (rendered_frames, module.reference_frames))
    np.testing.assert_allclose(ours.centers_px, theirs.centers_px)
    np.testing.assert_allclose(ours.bounds, theirs.bounds)
    y, x = np.mgrid[: ours.image.shape[0], : ours.image.shape[1]]
    for (u, v), side in zip(ours.centers_px, ours.sides_px, strict=True):
        inside = np.hypot(x - u, y - v) < 0.4 * side
        away = np.abs(ours.image[inside].astype(int) - theirs.image[inside])
        assert away.max() <= 1


def test_bound_grows_with_noise_and_shrinks_with_side():
    def bound(cell):
        return np.trace(first_frame(cell).bounds[:, :2, :2].mean(axis=0))

    assert bound(Cell(noise=10.0)) > 3 * bound(Cell())
    assert bound(Cell(side_px=60.0)) < bound(Cell()) < bound(Cell(side_px=16.0))
    assert bound(Cell(contrast=80.0)) > 4 * bound(Cell())


@pytest.fixture
def stranger(tmp_path, monkeypatch):
    """Write a module of detectors in the working folder, as a user would."""
    (tmp_path / "strange_detectors.py").write_text(STRANGER, "utf-8")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", list(sys.path))
    yield "strange_detectors"
    sys.modules.pop("strange_detectors", None)


def test_user_detector_is_measured(stranger):
    """It detects nothing in every other frame: half the recall of the detector that it wraps."""
    plan = Plan(("photometric", f"{stranger}:Shy"), "4X4_50", seed=1)
    ours, theirs = measure_cells(plan, [Cell(noise=2.0, cameras=1, frames=4)])
    assert ours["recall"] > 0.9
    assert theirs["recall"] == pytest.approx(ours["recall"] / 2, abs=0.05)
    assert theirs["detector"] == "strange_detectors:Shy"
    assert set(ours) >= ROW_KEYS


def test_documentation_example_works(tmp_path, monkeypatch):
    """The ten documented lines, with a library instead of the reader's own."""
    text = (Path(__file__).parents[2] / "docs" / "benchmark.md").read_text("utf-8")
    (tmp_path / "mine.py").write_text(text.split("```python\n")[1].split("```")[0], "utf-8")
    (tmp_path / "my_library.py").write_text(
        "from skyherd.vision import create_detector\n"
        "def find_markers(image):\n"
        "    seen = create_detector().detect(image)\n"
        "    return seen.ids, seen.corners_px\n"
    )
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", list(sys.path))
    (row,) = measure_cells(Plan(("mine:make",), "4X4_50", 1), [Cell(noise=2.0, cameras=1, frames=2)])
    for module in ("mine", "my_library"):
        sys.modules.pop(module)
    assert row["recall"] > 0.9 and row["nees"] is None and row["rmse_px"] < 0.2


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("strange_detectors:Absent", "has no attribute 'Absent'"),
        ("no_such_module:make", "No module named 'no_such_module'"),
        ("strange_detectors:", "module:factory"),
        ("photometrik", "one of apriltag3, locus-tag"),
    ],
)
def test_uncreatable_detector_is_named(stranger, name, words):
    with pytest.raises(InputError, match=words):
        make_entrant(name, "4X4_50")


def test_failing_detector_is_named(stranger):
    with pytest.raises(EntrantError, match="strange_detectors:Broken: ZeroDivisionError: no luck"):
        measure_cells(Plan((f"{stranger}:Broken",), "4X4_50", 1), [Cell(cameras=1, frames=1)])


def test_peers_get_supported_dictionary():
    assert dictionary_for("apriltag3", "4X4_50") == "APRILTAG_36h11"
    assert dictionary_for("apriltag3", "APRILTAG_25h9") == "APRILTAG_25h9"
    assert dictionary_for("locus-tag", "4X4_50") == dictionary_for("opencv", "4X4_50") == "4X4_50"
    assert dictionary_for("locus-tag", "5X5_50") == "APRILTAG_36h11"
    assert dictionary_for("photometric", "4X4_50") == "4X4_50"
    assert default_entrants()[0] == "opencv"


def test_uncorrected_peers_show_bias():
    cell = Cell(noise=2.0, cameras=1, frames=2)
    plan = Plan(("opencv-apriltag",), "4X4_50", 1)
    (corrected,) = measure_cells(plan, [cell])
    (raw,) = measure_cells(replace(plan, corrected=False), [cell])
    assert raw["bias_px"] == pytest.approx(0.46 * 2**0.5, abs=0.05)
    assert corrected["bias_px"] < 0.05


def test_times_skip_warm_up_and_relate_to_opencv():
    cells = timing_cells(WARM_UP + 8, ((320, 240),))
    rows = measure_times(Plan(("opencv", "photometric"), "4X4_50", 1), cells, budget_s=60.0)
    assert [(r["detector"], r["noise"]) for r in rows] == [
        ("opencv", 0.0), ("photometric", 0.0), ("opencv", 5.0), ("photometric", 5.0)
    ]  # fmt: skip
    for row in rows:
        assert row["frames"] == 8
        assert 0 < row["ms_median"] <= row["ms_p99"]
    assert rows[0]["times_faster"] == 1.0
    assert rows[1]["times_faster"] == pytest.approx(rows[0]["ms_median"] / rows[1]["ms_median"])


def test_detector_over_time_budget_is_skipped():
    cells = timing_cells(60, ((320, 240),))[:1]
    (row,) = measure_times(Plan(("opencv",), "4X4_50", 1), cells, budget_s=0.0)
    assert row["frames"] < 20


@pytest.fixture(scope="module", params=["base", pytest.param("all", marks=pytest.mark.slow)])
def result(request):
    """Return the result of the quick design, each cell measured, or of the base cell and the empty cells."""
    plan = Plan(("opencv", "photometric"), "4X4_50", seed=1)
    cells = [cell for cell in quick_design(2) if cell.side_px < 60]
    cells = [replace(cell, cameras=1, frames=1) for cell in cells]
    if request.param == "all":
        rows = measure_cells(plan, cells)
    else:
        base, empty = (
            measure_cells(plan, [next(cell for cell in cells if (cell.sweep == EMPTY) == is_empty)])
            for is_empty in (False, True)
        )
        rows = [
            row | cell.factors() | ({} if cell.blur_px is None else {"blur_px": cell.blur_px})
            for cell in cells
            for row in (empty if cell.sweep == EMPTY else base)
        ]
    times = measure_times(plan, timing_cells(WARM_UP + 2, ((320, 240), (400, 300))), 0.1)
    return Result(environment(seed=1, quick=True), rows, times)


def test_result_is_read_back(result, tmp_path):
    result.write(tmp_path)
    assert read_result(tmp_path) == result
    with pytest.raises(InputError, match=r"bench\.json: no such file"):
        read_result(tmp_path / "elsewhere")
    (tmp_path / RESULT).write_text("{}")
    with pytest.raises(InputError, match="cannot be read"):
        read_result(tmp_path)


def test_tables_are_complete_with_own_detectors_first(result):
    tables = make_tables(result)
    assert len(tables) == 8
    for table in tables:
        assert all(len(row) == len(table.header) for row in table.rows)
    assert [row[0] for row in tables[0].rows] == ["photometric", "opencv"]
    honesty = next(table for table in tables if "NEES" in table.title)
    assert [row[0] for row in honesty.rows] == ["photometric"]


@pytest.mark.parametrize(
    ("value", "text"),
    [(1.0834, "1.08"), (0.8, "0.80"), (9.996, "10.0"), (10.04, "10.0"), (99.96, "100"), (None, "–")],
)
def test_short_number_format(value, text):
    assert short(value) == text


def test_share_is_100_percent_only_for_all():
    assert [share(value) for value in (1.0, 0.9999, 0.5, 0.0001, 0.0, None)] == [
        "100.0 %", "99.9 %", "50.0 %", "0.1 %", "0.0 %", "–"
    ]  # fmt: skip


@pytest.fixture(scope="module")
def page(result, tmp_path_factory) -> Path:
    return write_outputs(result, tmp_path_factory.mktemp("bench"))


def test_all_figures_and_tables_are_made(page):
    drawn = sorted(path.name for path in (page.parent / "figures").glob("*.png"))
    assert drawn == [
        "accuracy.png", "camera.png", "camera_recall.png", "factor_recall.png", "factors.png", "honesty.png",
        "recall.png", "times.png",
    ]  # fmt: skip
    text = (page.parent / MARKDOWN).read_text("utf-8")
    assert text.count("### ") == 8 and "| photometric |" in text


@pytest.mark.parametrize("width", [1280, 390])
def test_page_fits_desktop_and_phone(browser, page, width, assert_nothing_overflows):
    window = browser.new_page(viewport={"width": width, "height": 844})
    complaints, requests = [], []
    window.on("console", lambda message: complaints.append(message.text))
    window.on("request", lambda asked: requests.append(asked.url))
    window.goto(page.as_uri(), wait_until="load")
    assert_nothing_overflows(window)
    assert window.evaluate("[...document.images].every(image => image.naturalWidth > 0)")
    window.evaluate("document.querySelectorAll('details').forEach(e => { e.open = true })")
    assert_nothing_overflows(window)
    window.close()
    assert not complaints
    assert [url[:60] for url in requests if not url.startswith(("file:", "data:"))] == []


def run(*arguments):
    with pytest.raises(SystemExit) as done:
        main(["bench", "detectors", *map(str, arguments)])
    return done.value.code


def test_command_writes_its_files(tmp_path, monkeypatch, capfd):
    """With a design cut to two cells, and one figure: the rest is common to all."""
    monkeypatch.setattr("skyherd.bench.detectors.plots.PLOTS", PLOTS[:1])
    cells = [replace(cell, cameras=1, frames=1) for cell in quick_design(1)[:2]]
    monkeypatch.setattr("skyherd.bench.detectors.design.quick_design", lambda **kind: cells)
    monkeypatch.setattr("skyherd.cli.bench.QUICK_FRAMES", WARM_UP + 1)
    monkeypatch.setattr("skyherd.cli.bench.QUICK_SIZES_PX", ((320, 240),))
    out = tmp_path / "deep" / "bench"
    assert run("--quick", "--out", out, "--detectors", "opencv, photometric", "--jobs", 1, "--seed", 7) == 0
    assert {path.name for path in out.iterdir()} == {".skyherd.json", PAGE, RESULT, MARKDOWN, "figures"}
    told = capfd.readouterr()
    assert told.err == "" and PAGE in told.out
    content = json.loads((out / RESULT).read_text("utf-8"))
    assert content["environment"]["seed"] == 7 and content["environment"]["threads_per_detector"] == 1
    assert {row["detector"] for row in content["rows"]} == {"opencv", "photometric"}


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--detectors", "aruko"), "no detector 'aruko'"),
        (("--detectors", "opencv,opencv"), "opencv named twice"),
        (("--detectors", "nowhere:make"), "No module named 'nowhere'"),
        (("--dictionary", "5Y5"), "no dictionary '5Y5'"),
        (("--jobs", 0), "a whole number from 1"),
        (("--clutter-images", -1), "a whole number from 0"),
    ],
)
def test_bad_input_gives_one_line_and_exit_code_2(arguments, words, tmp_path, capfd):
    assert run("--quick", "--out", tmp_path / "out", *arguments) == 2
    told = capfd.readouterr()
    assert told.err.count("\n") == 1 and words in told.err
    assert not list((tmp_path / "out").glob("*")) if (tmp_path / "out").exists() else True


@pytest.mark.parametrize("shrink", [1.5, 2.0, 2.7])
def test_shrunk_keeps_light_and_moves_truth(shrink):
    """A ramp matches the ramp of the true points to rounding, except at the far image ends. Integer factors
    average whole pixels.
    """
    values = np.add.outer(np.arange(80) * 0.7, np.arange(110) * 1.2)
    frame = next(rendered_frames(Cell(cameras=1, frames=1), "4X4_50", 1))
    ramp = replace(frame, image=np.rint(values).astype(np.uint8), centers_px=np.array([[30.0, 40.0]]))
    small = shrunk(ramp, shrink)
    v, u = np.mgrid[: small.image.shape[0] - 2, : small.image.shape[1] - 2]
    there = ((v + 0.5) * shrink - 0.5) * 0.7 + ((u + 0.5) * shrink - 0.5) * 1.2
    assert np.abs(small.image[:-2, :-2] - there).max() < 1.1
    back = (small.centers_px + 0.5) * shrink - 0.5
    np.testing.assert_allclose(back, [[30.0, 40.0]])
    np.testing.assert_allclose(small.bounds[:, 0, 0] * shrink**2, ramp.bounds[:, 0, 0])
    np.testing.assert_allclose(small.bounds[:, 2, 2], ramp.bounds[:, 2, 2])
    if shrink == 2.0:
        whole = frame.image.astype(float).reshape(240, 2, 320, 2).mean(axis=(1, 3))
        np.testing.assert_array_equal(shrunk(frame, 2.0).image, np.rint(whole))
