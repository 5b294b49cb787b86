"""Compiled functions of the fit: equal bytes on every build, and their checks of arguments.

Their values are checked where they are used: columns by `test_design_matrix` and `test_elliptic_blur`, sums
by `test_correlated_noise`, held unknowns by `test_least_squares` and planes by `test_plane`.
"""

from dataclasses import replace

import numpy as np
import pytest
from tests.helpers.fit_stages import BLOCK_PX, COLUMNS, MARKER, declared_stages, stages

from skyherd.errors import InputError
from skyherd.native import build
from skyherd.native.loading import load
from skyherd.vision.native.library import library
from skyherd.vision.native.records import UNKNOWNS
from skyherd.vision.photometric.fitting.plane import plane_limits

N_CELLS = 6
RIGHT, DOWN, BLUR = 2, 3, 6
"""Columns of slopes along x and y, and along the logarithm of the blur, as in `fit.h`."""
SIGMAS = (0.01, 0.05, 0.09, 0.12, 0.3)
"""Blurs of 0.06 to 1.8 cells, in sides: 2, 4, 6 and 8 edges in reach, and all of them."""

BLURS = np.array([[s**2, (1.5 * s) ** 2, 0.5 * s**2, 2 * s**2, 4.5 * s**2, s**2] for s in SIGMAS])
"""The same along x, and half as much more along y, correlated by a third."""


def image_of(seed=0):
    return np.random.default_rng(seed).integers(0, 256, (120, 160), dtype=np.uint8)


def markers_of(seed=0):
    """Five markers of 13 to 40 px across the image, one of them over its edge."""
    rng, markers = np.random.default_rng(seed), np.zeros(len(SIGMAS), dtype=MARKER)
    sides = rng.uniform(13, 40, len(SIGMAS)) * np.exp(2j * np.pi * rng.random(len(SIGMAS)))
    markers["center"] = rng.uniform(0, 160, len(SIGMAS)) + 1j * rng.uniform(0, 120, len(SIGMAS))
    markers["x_axis"], markers["y_axis"] = sides / np.abs(sides) ** 2, 1j * sides / np.abs(sides) ** 2
    markers["perspective"], markers["keystone"] = 1e-3 + 5e-4j, 0.02 + 0.01j
    markers["limit"], markers["strip"], markers["half_card"] = 0.6, 0.7, 0.66
    markers["height_px"], markers["sigma"] = np.abs(sides), SIGMAS
    markers["black_ratio"], markers["x_stretch"], markers["y_stretch"] = 0.15, 0.9, 1.1
    return markers


def cells_of(seed=0):
    cells = np.zeros((len(SIGMAS), N_CELLS + 2, N_CELLS + 2), dtype=np.float32)
    cells[:, 1:-1, 1:-1] = np.random.default_rng(seed).random((len(SIGMAS), N_CELLS, N_CELLS)) < 0.5
    return cells


def bytes_of(build_of_library):
    """Return the bytes of all results of all functions, on the same input."""
    rng, markers, results = np.random.default_rng(1), markers_of(), []
    for is_elliptic in (False, True):
        blocks = build_of_library.list_pixels(markers, (120, 160))
        bends = np.zeros((len(blocks.columns), 3, BLOCK_PX), dtype=np.float32)
        if is_elliptic:
            build_of_library.fill_elliptic(image_of(), markers, BLURS, cells_of(), 6.0, blocks, bends)
        else:
            build_of_library.fill_round(image_of(), markers, cells_of(), 6.0, blocks)
        solutions = rng.normal(size=(len(markers), UNKNOWNS)).astype(np.float32)
        influences = rng.normal(size=(len(markers), 3, UNKNOWNS)).astype(np.float32)
        grams = build_of_library.gram_matrices(blocks)
        results += [blocks.bounds, blocks.counts, blocks.places, blocks.pixels, blocks.columns, bends, grams]
        results += [build_of_library.residuals(blocks, solutions)]
        results += build_of_library.cell_sums(blocks, solutions, N_CELLS)
        results += build_of_library.squared_box_sums(blocks, solutions, influences, np.array([4, 1]), 2)
        values, squares = rng.normal(size=(5, UNKNOWNS)), np.ones(5)
        normals = np.linalg.inv(grams[:, :UNKNOWNS, :UNKNOWNS].astype(float) + np.eye(UNKNOWNS))
        for unknowns in ((2, 2), (8, 9)):
            at = np.zeros((5, len(set(unknowns))))
            build_of_library.hold_unknowns(values, normals, squares, unknowns, at, np.ones(5))
        results += [values, normals, squares]
    points = 100 * (rng.normal(size=9) + 1j * rng.normal(size=9))
    anisotropies = 0.1 + 0.05j - points * 1e-3 + 1e-3 * rng.normal(size=9)
    given = points, anisotropies, np.full(9, 1e-6), plane_limits()
    results += [build_of_library.fit_plane(*given, most=most) for most in (False, True)]
    return b"".join(np.ascontiguousarray(one).tobytes() for one in results)


def test_builds_give_equal_bytes():
    folder, best = build.sources_folder("vision"), int(library().functions.processor_level())
    levels = [level for level in build.levels() if level <= best]
    builds = [declared_stages(load(folder / build.library_name("vision", level), folder)) for level in levels]
    assert len({bytes_of(one) for one in builds}) == 1


@pytest.mark.parametrize("reach_cells", [1, 2, 3, 4])
def test_one_more_edge_on_either_side_changes_little(reach_cells):
    """Beyond the reach, edges add 3e-7 to Φ, and 8e-6 to its curvature; to few columns by several of them."""
    markers, columns = markers_of(), []
    for factor in (1 - 1e-7, 1 + 1e-7):
        markers["sigma"] = factor * reach_cells / (5 * N_CELLS)
        blocks = stages().list_pixels(markers, (120, 160))
        stages().fill_round(image_of(), markers, cells_of(), 6.0, blocks)
        columns.append(blocks.columns)
    assert not np.array_equal(*columns)
    np.testing.assert_allclose(*columns, atol=5e-5, rtol=1e-5)


@pytest.mark.parametrize("is_elliptic", [False, True])
def test_squares_of_slopes_are_zero_or_normal_numbers(is_elliptic):
    """Products below 1e-38 take a hundred times as long; far from edges, slopes are zero instead."""
    markers, sigma = markers_of(), 0.6 / 80
    markers["x_axis"] /= np.abs(markers["x_axis"]) * 80
    markers["y_axis"] = 1j * markers["x_axis"]
    markers["height_px"], markers["sigma"], markers["half_card"] = 80, sigma, np.inf
    blurs = np.tile(BLURS[:1] * sigma**2 / BLURS[0, 0], (len(markers), 1))
    blocks = stages().list_pixels(markers, (120, 160))
    bends = np.zeros((len(blocks.columns), 3, BLOCK_PX), dtype=np.float32)
    if is_elliptic:
        stages().fill_elliptic(image_of(), markers, blurs, cells_of(), 6.0, blocks, bends)
    else:
        stages().fill_round(image_of(), markers, cells_of(), 6.0, blocks)
    slopes = np.abs(blocks.columns[:, [RIGHT, DOWN, BLUR]]).astype(float)
    assert slopes[slopes > 0].min() ** 2 > np.finfo(np.float32).tiny
    assert (slopes == 0).mean() > 0.2 and (slopes > 0.1).any()


def changed_blocks(name):
    """Return blocks of which one array is invalid."""
    blocks = stages().list_pixels(markers_of(), (120, 160))
    arrays = {
        "bounds of int32": {"bounds": blocks.bounds.astype(np.int32)},
        "bounds beyond the blocks": {"bounds": blocks.bounds + 1},
        "bounds that descend": {"bounds": blocks.bounds[::-1].copy()},
        "negative bounds": {"bounds": blocks.bounds - 1},
        "counts beyond the blocks": {"counts": blocks.counts + BLOCK_PX},
        "counts below the last block": {"counts": blocks.counts - BLOCK_PX},
        "columns of other blocks": {"columns": np.zeros((3, COLUMNS, BLOCK_PX), np.float32)},
        "strided columns": {
            "columns": np.zeros((len(blocks.columns), 2 * COLUMNS, BLOCK_PX), np.float32)[:, ::2]
        },
        "pixels beyond the image": {"pixels": blocks.pixels + 160},
        "negative pixels": {"pixels": -1 - blocks.pixels},
    }
    return replace(blocks, **arrays[name])


@pytest.mark.parametrize(
    "name",
    [
        *("bounds of int32", "bounds beyond the blocks", "bounds that descend", "negative bounds"),
        *("counts beyond the blocks", "counts below the last block", "columns of other blocks"),
        *("strided columns", "pixels beyond the image", "negative pixels"),
    ],
)
def test_invalid_blocks_are_rejected(name):
    blocks, bends = changed_blocks(name), np.zeros((10**5, 3, BLOCK_PX), np.float32)
    with pytest.raises(InputError):
        stages().fill_round(image_of(), markers_of(), cells_of(), 6.0, blocks)
    with pytest.raises(InputError):
        stages().fill_elliptic(
            image_of(), markers_of(), BLURS, cells_of(), 6.0, blocks, bends[: len(blocks.columns)]
        )
    if "pixels" not in name:
        with pytest.raises(InputError):
            stages().gram_matrices(blocks)


@pytest.mark.parametrize("is_elliptic", [False, True])
def test_last_blocks_repeat_their_last_pixel_without_weight(is_elliptic):
    blocks = stages().list_pixels(markers_of(), (120, 160))
    bends = np.ones((len(blocks.columns), 3, BLOCK_PX), dtype=np.float32)
    if is_elliptic:
        stages().fill_elliptic(image_of(), markers_of(), BLURS, cells_of(), 6.0, blocks, bends)
    else:
        stages().fill_round(image_of(), markers_of(), cells_of(), 6.0, blocks)
    partial = np.flatnonzero(blocks.counts % BLOCK_PX)
    assert len(partial) >= 3 and blocks.is_pixel().sum() == blocks.counts.sum()
    for marker in partial:
        last, used = blocks.bounds[marker + 1] - 1, blocks.counts[marker] % BLOCK_PX
        assert blocks.is_pixel()[last].tolist() == [True] * used + [False] * (BLOCK_PX - used)
        for of_block in (blocks.places[last], blocks.pixels[last]):
            assert (of_block[:, used:] == of_block[:, used - 1 : used]).all()
        assert blocks.columns[last, :, :used].any() and not blocks.columns[last, :, used:].any()
        assert bends[last, :, used:].any() != is_elliptic


def test_invalid_sizes_are_rejected():
    blocks = stages().list_pixels(markers_of(), (120, 160))
    stages().fill_round(image_of(), markers_of(), cells_of(), 6.0, blocks)
    model = np.zeros((len(SIGMAS), UNKNOWNS), dtype=np.float32)
    with pytest.raises(InputError):
        stages().fill_round(image_of(), markers_of(), np.zeros((5, 30, 30), np.float32), 6.0, blocks)
    with pytest.raises(InputError):
        stages().cell_sums(blocks, model, 21)
    with pytest.raises(InputError):
        stages().residuals(blocks, model[:3])
    for picked, box_px in (([5], 2), ([-1], 2), ([0], 0)):
        with pytest.raises(InputError):
            stages().squared_box_sums(blocks, model, model[:, None], np.array(picked), box_px)
    with pytest.raises(InputError):
        stages().hold_unknowns(
            np.zeros((1, 15)), np.zeros((1, 15, 15)), np.zeros(1), (3, 15), np.zeros((1, 2)), np.zeros(1)
        )
    with pytest.raises(InputError):
        stages().list_pixels(np.zeros(3), (120, 160))
