"""Loading of compiled libraries: missing, stale and invalid files; memory safety under sanitizers."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from skyherd.errors import InputError, NativeLibraryError
from skyherd.native import build
from skyherd.native.loading import load
from skyherd.render.native import library as render
from skyherd.vision.native import library as vision

LEVEL = build.levels()[0]
SANITIZERS = ("-g", "-O1", "-fsanitize=address,undefined", "-fno-sanitize-recover=all")


SOURCES = build.sources_folder("vision")
NAME = build.library_name("vision", LEVEL)


def compiled(folder, *options, package="vision"):
    """Return the path of a library that is compiled into a folder."""
    path = folder / build.library_name(package, LEVEL)
    build.compile_library(build.sources_folder(package), path, build.compiler_command(LEVEL), options)
    return path


def test_missing_library_names_the_command(tmp_path):
    with pytest.raises(NativeLibraryError, match=r"missing.*python src/skyherd/native/build.py"):
        load(tmp_path / "none.so", SOURCES)


def test_file_that_is_no_library_is_rejected(tmp_path):
    path = tmp_path / NAME
    path.write_bytes(b"no library")
    with pytest.raises(NativeLibraryError, match="cannot be loaded"):
        load(path, SOURCES)


def test_library_of_other_sources_is_rejected(tmp_path):
    """The build is that of the checkout, and then a source changes."""
    for path in [*SOURCES.glob("*.c"), *SOURCES.glob("*.h")]:
        shutil.copy(path, tmp_path)
    load(SOURCES / NAME, tmp_path)
    with (tmp_path / "search.c").open("a") as source:
        source.write("/* changed */\n")
    with pytest.raises(NativeLibraryError, match="another version"):
        load(SOURCES / NAME, tmp_path)


def test_compiler_failure_names_the_compiler(tmp_path):
    with pytest.raises(RuntimeError, match="cannot compile"):
        compiled(tmp_path, "-fno-such-option")


def fuzz_vision(path, seed=0, images=150):
    """Search random images of 2 to 70 px, also with invalid sizes; return the number of quadrilaterals."""
    from skyherd.vision.search.edges import edge_parameters
    from skyherd.vision.search.quads import search_parameters

    rng = np.random.default_rng(seed)
    library = vision.declared(load(Path(path), SOURCES))
    found = 0
    for number in range(images):
        height, width = 2 * rng.integers(1, 36, 2)
        image = rng.integers(0, 256, (height, width), dtype=np.uint8)
        if number % 3:  # blocks, which have regions and quadrilaterals
            side = int(rng.integers(1, 20))
            image = np.ascontiguousarray(np.kron(image, np.ones((side, side), np.uint8))[:height, :width])
        places = np.full((height // 2, width // 2), 255, np.uint8)
        for enlargement in (1, 2):
            found += len(library.quads(image, places, search_parameters(range(3), enlargement))[0])
        library.large_boundaries(image, int(rng.integers(0, 40)), int(rng.integers(0, 12)))
        quads = rng.uniform(-20, 90, (int(rng.integers(0, 4)), 4, 2))
        quads[rng.random(quads.shape) < 0.1] = rng.choice([0.0, 1e300, np.inf, -np.inf, np.nan, 1e9])
        fine, side = (int(value) for value in rng.integers(1, 4, 2))
        library.sampled_squares(image, quads, rng.uniform(-1, 2, fine * side), fine)
        library.refined_corners(image, quads, int(rng.integers(1, 12)), edge_parameters())
        if min(height, width) >= 4:
            blocks = rng.normal(0, 10, (4, height // 4, width // 4)).astype(np.float32)
            blocks[rng.random(blocks.shape) < 0.1] = rng.choice([np.nan, np.inf, -1e38])
            is_sharp = rng.integers(0, 256, blocks.shape[1:], dtype=np.uint8)
            library.stretched(image, blocks[:2], blocks[2:], is_sharp)
    for size in [(1, 1), (1, 70), (70, 1), (0, 2), (-2, 2), (3, 4), (1 << 21, 2), (1 << 15, 1 << 15)]:
        assert library.functions.search_workspace_bytes(*size) == 0
        assert library.functions.search_quads(None, None, *size, None, None, 0, None, None, 0) < 0
        assert library.functions.search_boundaries(None, *size, 8, 1, None, 0, None, 0, None, 0) < 0
    fuzz_codes(library, rng)
    fuzz_patterns(library, rng)
    return found + fuzz_fit(library, rng)


def fuzz_codes(library, rng, requests=100):
    """Compare random samples, a tenth of them absurd, with random codes; the padding is never the result."""
    from skyherd.vision.native.search_library import CodeColumns, CodeTable, CodeTableStructure
    from skyherd.vision.search.decode import CONSTANTS

    for _ in range(requests):
        rows, cells, count = int(rng.integers(0, 10)), int(rng.integers(1, 70)), int(rng.integers(1, 100))
        samples = rng.normal(0, 1, (rows, cells)).astype(np.float32)
        samples[rng.random(samples.shape) < 0.1] = rng.choice([0.0, 1e38, np.inf, np.nan])
        codes = CodeColumns.of(-np.abs(rng.normal(0, 1, (count, cells)).astype(np.float32)))
        tables = [CodeTable(codes, *rng.uniform(0, 1, (2, count))) for _ in range(3)]
        of_rows = rng.integers(0, 3, rows).astype(np.int32)
        best = library.decoded(samples, of_rows, tables, rng.uniform(-1, 1, 3), CONSTANTS)["code"]
        assert ((best >= 0) & (best < count)).all()
        if rows:
            of_rows[-1] = rng.choice([-1, 3])
            with pytest.raises(InputError):
                library.decoded(samples, of_rows, tables, [0.0, 0.0, 0.0], CONSTANTS)
        assert library.code_products(samples, codes).shape == (rows, count)
    codes = CodeColumns.of(np.zeros((40, 4), np.float32)).columns.ctypes.data
    for size in [
        (-1, 4, 40, 64),
        (1, 0, 40, 64),
        (1, 4, 0, 64),
        (1, 4, 65, 64),
        (1, 4, 40, 40),
        (1, 2000, 40, 64),
    ]:
        rows, cells, count, stride = size
        table = CodeTableStructure(codes, None, None, count, stride, 0.0)
        assert library.functions.decode_cells(None, rows, cells, None, table, 1, CONSTANTS, None) < 0
        assert library.functions.code_products(None, rows, cells, codes, count, stride, None) < 0


def fuzz_patterns(library, rng, requests=60):
    """Fit random patterns to random readings, of grids of 1 to 20 cells, some with absurd numbers."""
    from skyherd.vision.native.pattern_records import PatternRequest
    from skyherd.vision.photometric.evidence.pattern_fit import pattern_constants

    for _ in range(requests):
        n, count, each = int(rng.integers(1, 21)), int(rng.integers(0, 4)), int(rng.integers(0, 4))
        parts = (3 * n + 6) ** 2
        levels, seen, grounds = (rng.random((count, parts)).astype(np.float32) for _ in range(3))
        scales, weights, ranges = rng.uniform(1, 200, (3, count))
        patterns = rng.random((count, each, parts)).astype(np.float32)
        for numbers in (levels, seen, grounds, scales, weights, ranges, patterns):
            if rng.random() < 0.1:
                numbers[rng.random(numbers.shape) < 0.1] = rng.choice([0.0, np.nan, np.inf, -1e30])
        ground = [None, grounds, grounds[:1]][rng.integers(0, 3)]
        about = ground, pattern_constants(), n, bool(rng.integers(0, 2))
        library.fit_patterns(PatternRequest(levels, seen, scales, weights, ranges, patterns, *about))
        edges = int(rng.integers(3, 20))
        unexplained = rng.uniform(-1, 1, ((edges - 1) * (edges - 2) // 2,) * 2)
        sums = rng.choice([0.0, 1.0, np.nan, np.inf, -1e300], (count, edges, edges))
        library.best_rectangles(sums, unexplained, int(rng.integers(1, unexplained.size + 1)))


def fuzz_fit(library, rng, images=150):
    """Read and draw markers of any size, shape and blur in random images; return the number of pixels."""
    from fit_stages import BLOCK_PX, MARKER, declared_stages

    from skyherd.vision.native.records import UNKNOWNS

    stages, pixels = declared_stages(library.functions), 0
    for _ in range(images):
        height, width = (int(side) for side in rng.integers(1, 60, 2))
        count, n = int(rng.integers(0, 4)), int(rng.integers(1, 21))
        markers = np.zeros(count, dtype=MARKER)
        for name in MARKER.names:
            wild = rng.choice([0.0, 1e-300, 1e300, np.inf, np.nan, -1.0]) if rng.random() < 0.1 else None
            is_whole = np.issubdtype(MARKER[name], np.integer)
            wild = rng.integers(-1, 3) if is_whole else wild
            markers[name] = 10 ** rng.uniform(-3, 0.5, count) if wild is None else wild
        markers["center"] += rng.uniform(-20, 80, count) + 1j * rng.uniform(-20, 80, count)
        markers["height_px"] *= 20
        image = rng.integers(0, 256, (height, width), dtype=np.uint8)
        cells = (rng.random((count, n + 2, n + 2)) < 0.5).astype(np.float32)
        blocks = stages.list_pixels(markers, image.shape)
        bends = np.zeros((len(blocks.columns), 3, BLOCK_PX), dtype=np.float32)
        stages.fill_elliptic(image, markers, rng.normal(size=(count, 6)), cells, 6.0, blocks, bends)
        stages.fill_round(image, markers, cells, 6.0, blocks)
        solutions = rng.normal(size=(count, UNKNOWNS)).astype(np.float32)
        stages.gram_matrices(blocks)
        stages.residuals(blocks, solutions)
        stages.cell_sums(blocks, solutions, n)
        picked = np.arange(count)[rng.random(count) < 0.5]
        stages.squared_box_sums(blocks, solutions, np.repeat(solutions[:, None], 3, axis=1), picked, 2)
        pixels += int(blocks.counts.sum()) + fuzz_marker_fit(library, rng, image, cells, count)
    return pixels


def fuzz_marker_fit(library, rng, image, cells, count):
    """Fit markers from random places in an image; return the number of pixels of those that are finite."""
    from skyherd.vision.native.records import (
        APPEARANCE,
        HOMOGRAPHY,
        PLANE,
        BlurRequest,
        FitRequest,
        VisibleRequest,
    )
    from skyherd.vision.photometric.fitting.appearance import appearance_constants
    from skyherd.vision.photometric.fitting.fit import fit_constants
    from skyherd.vision.photometric.fitting.occlusion import visible_constants
    from skyherd.vision.photometric.refine import blur_constants

    if not count:
        return 0
    start, looks, plane = np.zeros(count, HOMOGRAPHY), np.zeros(count, APPEARANCE), np.zeros(1, PLANE)
    for records, scale in ((start, 20.0), (looks, 1.0)):
        for name in records.dtype.names:
            wild = rng.choice([0.0, 1e-300, 1e300, np.inf, np.nan, -1.0]) if rng.random() < 0.1 else None
            records[name] = scale * rng.normal(size=count) if wild is None else wild
    start["perspectives"] /= 1e4
    looks["surroundings"]["levels"][rng.random(count) < 0.5] = np.nan  # on cards
    plane["shared"] = rng.integers(0, 2)
    plane["perspective"] = 1e-3 * rng.normal()
    streak = None if rng.random() < 0.5 else complex(rng.normal())
    given = image, start, looks, cells, fit_constants(), 6.0, 3.0, 6, bool(rng.integers(0, 2)), streak
    fits, _ = library.fit_markers(FitRequest(*given), plane)
    library.fit_freely(FitRequest(*given), float(rng.choice([1e-3, 1e300, np.inf])))
    if streak is not None:
        library.streak_evidence(FitRequest(*given))
    levels = (scale * rng.normal(size=count) for scale in (50.0, 100.0, 2.0))
    blacks, contrasts, sigmas_px = (
        each if rng.random() < 0.9 else each * rng.choice([0.0, 1e300, np.inf, np.nan]) for each in levels
    )
    border = int(rng.integers(0, 4))
    visible = VisibleRequest(FitRequest(*given), visible_constants(), blacks, contrasts, sigmas_px, border)
    library.fit_visible(visible, plane)
    about = (
        appearance_constants("4X4_50"),
        blur_constants(),
        3.0,
        6,
        False,
        streak,
        float(rng.choice([8, 144])),
    )
    blurs = (
        image,
        start,
        np.abs(sigmas_px),
        np.ascontiguousarray(looks["surroundings"]),
        cells,
        fit_constants(),
        *about,
    )
    library.fit_any_blur(BlurRequest(*blurs, int(rng.integers(0, 7)), None), plane)
    fuzz_following(library, rng, image, cells, start)
    return int(np.nan_to_num(fits["pixels"]).sum())


def fuzz_following(library, rng, image, cells, places):
    """Follow markers from random tracks and estimates; every second request lets all fits count as usual."""
    from skyherd.vision.native.follow_records import TRACK, Estimates, FollowConstants, FollowRequest
    from skyherd.vision.native.records import PLANE
    from skyherd.vision.photometric.fitting.fit import fit_constants
    from skyherd.vision.photometric.following import follow_constants

    tracks, constants = (
        np.zeros(len(places), TRACK),
        FollowConstants.from_buffer_copy(follow_constants("4X4_50")),
    )
    tracks["homographies"], tracks["sigmas_px"] = places, rng.uniform(0.3, 3, len(places))
    for name in ("velocities", "similarity_log_rates", "times_s", "sigmas_px"):
        if rng.random() < 0.3:
            tracks[name] = rng.choice([0.0, 1e-300, 1e300, np.inf, np.nan, -1.0, 1.0], len(places))
    tracks["surroundings"]["levels"] = rng.choice([np.nan, np.nan, 0.0, -0.4, np.inf], len(places))
    tracks["on_arc"], tracks["missed"] = rng.integers(0, 2, len(places)), rng.integers(0, 20, len(places))
    if rng.random() < 0.5:
        limits = constants.verification
        for name in ("min_cell_px", "min_contrast", "min_area_share", "min_print_share"):
            setattr(limits, name, -np.inf)
        for owner in (limits, constants, constants.blur):
            for name, _ in owner._fields_:
                if name.startswith("max_") and name not in ("max_missed", "max_ratio", "max_sigma_cells"):
                    setattr(owner, name, np.inf)
        for name in ("model_share", "cell_model_share", "strong_cell_limit", "wrong_bits"):
            setattr(limits, name, np.inf)
        limits.is_strong, constants.blur.settled, constants.outlier_share = 1, np.inf, np.inf
    estimates = Estimates(*rng.choice([np.nan, 0.0, 1.0, 100.0], 4), (1.0, np.inf), 1.0)
    about = np.zeros(1, PLANE), estimates, fit_constants(), constants
    library.follow_markers(FollowRequest(image, tracks, cells, *about, float(rng.normal()), 3.0, 6))


def fuzz_render(path, seed=0, images=100):
    """Draw random shapes and grounds, half of them with absurd numbers; return the number of drawn pixels."""
    from skyherd.render.edge import edge_spread

    rng = np.random.default_rng(seed)
    library = render.declared(load(Path(path), build.sources_folder("render")))
    changed = 0
    for number in range(images):
        size_px = height, width = tuple(rng.integers(1, 70, 2))
        count, corners, instants = int(rng.integers(0, 4)), int(rng.integers(3, 17)), int(rng.choice([1, 3]))
        cells = int(rng.choice([1, 2, 8, 62]))
        turns = np.sort(rng.uniform(0, 2 * np.pi, (count, corners)), axis=1)
        outlines_px = rng.uniform(-10, 80, (count, 1, 2)) + rng.uniform(0, 60) * np.stack(
            [np.cos(turns), np.sin(turns)], axis=-1
        )
        matrices = np.tile(np.eye(3), (instants, count, 1, 1)) * rng.uniform(0.05, 1)
        matrices += rng.normal(0, 0.01, matrices.shape)
        lens = rng.normal(0, 1, (6, height * width)).astype(np.float32) if rng.random() < 0.5 else None
        frame = render.Frame(np.linspace(-1, 1, height), lens)
        ground = np.linalg.inv(rng.normal(0, 1, (instants, 3, 3)))
        if number % 2:
            for numbers in [
                outlines_px,
                matrices,
                ground,
                frame.row_times,
                *([] if lens is None else [lens]),
            ]:
                absurd = rng.random(numbers.shape) < 0.1
                numbers[absurd] = rng.choice([0, np.nan, np.inf, -np.inf, 1e30, -1e-30, 3e9], absurd.sum())
        flat = render.FlatShapes(outlines_px, matrices, float(rng.uniform(0, 5)))
        spread = edge_spread(float(rng.choice([0.1, 0.8, 3.0])))
        levels = rng.uniform(0, 255, (count, cells + 2, cells + 2)).astype(np.float32)
        for canvas in np.zeros(size_px, np.uint8), np.zeros(size_px, np.float32):
            library.draw_lattices(canvas, frame, flat, levels, spread)
            library.draw_discs(canvas, frame, flat, levels[:, 0, 0].copy(), spread)
            changed += int((canvas != 0).sum())
        samples = int(2 ** rng.integers(1, 9))
        texture = rng.integers(0, 256, (samples, samples + 1, 2), dtype=np.uint8)
        library.draw_ground((width, height), frame, ground, texture)
    assert library.functions.draw_lattices(None, None, None, None, 1) < 0
    assert library.functions.draw_discs(None, None, None, None) < 0
    assert library.functions.draw_ground(None, None, 1, None, 2, 3) < 0
    return changed


@pytest.mark.slow
@pytest.mark.parametrize(
    ("package", "sanitizers"),
    [("vision", SANITIZERS), ("render", (*SANITIZERS, "-fsanitize=float-cast-overflow"))],
)
def test_fuzzed_input_violates_no_sanitizer(tmp_path, package, sanitizers):
    compiler = build.system_compiler()
    if compiler is None or sys.platform != "linux":
        pytest.skip("needs a C compiler and libasan on Linux")
    command = [compiler, "-print-file-name=libasan.so"]
    runtime = subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip()
    if not Path(runtime).is_absolute():
        pytest.skip("the compiler has no libasan")
    try:
        library = compiled(tmp_path, *sanitizers, package=package)
    except RuntimeError as error:
        pytest.skip(f"the compiler has no sanitizers: {error}")
    code = f"import test_library; print(test_library.fuzz_{package}({str(library)!r}))"
    paths = os.pathsep.join([str(Path(__file__).parent), *sys.path])
    environment = {
        **os.environ,
        "LD_PRELOAD": runtime,
        "ASAN_OPTIONS": "detect_leaks=0",
        "PYTHONPATH": paths,
    }
    ended = subprocess.run(
        [sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=False
    )
    assert ended.returncode == 0, ended.stderr[-2000:]
    assert int(ended.stdout.split()[-1]) > 0
