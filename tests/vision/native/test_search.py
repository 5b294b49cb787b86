"""The compiled search against its NumPy and OpenCV reference, on every build, and its checks of arguments."""

from functools import lru_cache

import cv2
import numpy as np
import pytest
import search_reference as reference
from native_builds import builds
from scipy.optimize import linear_sum_assignment

from skyherd.errors import InputError
from skyherd.vision.native.library import declared, library
from skyherd.vision.photometric.image_noise import image_noise
from skyherd.vision.search.faint import find_faint_quads
from skyherd.vision.search.quads import (
    ENLARGEMENT,
    GROWTH_PX,
    MIN_QUAD_SIDE_PX,
    SHRINKS,
    find_quads,
    search_parameters,
    small_quads,
)
from skyherd.vision.search.regions import Mosaic, crowded_places

TOLERANCE_PX = 1e-6
PLAIN = search_parameters(range(2))


def markers(size_px, count, noise, seed):
    """Return dark squares with light cells on light cards, some touching, with blur and noise."""
    rng = np.random.default_rng([1, seed])
    image = np.full(size_px[::-1], 150, np.uint8)
    for _ in range(count):
        side, turn = rng.uniform(8, 60), np.exp(1j * rng.uniform(-np.pi, np.pi))
        middle = complex(*(rng.uniform(0, size_px)))
        for scale, grey in ((1.4, 230), (1.0, 30), (0.3, 220)):
            z = middle + scale * side * turn * np.array([-1 - 1j, 1 - 1j, 1 + 1j, -1 + 1j]) / 2
            points = np.rint(16 * np.column_stack([z.real, z.imag])).astype(np.int32)
            cv2.fillPoly(image, [points], grey, cv2.LINE_AA, 4)
    image = cv2.GaussianBlur(image, (0, 0), 0.8) + noise * rng.standard_normal(image.shape)
    return np.clip(np.rint(image), 0, 255).astype(np.uint8)


def texture(size_px, scale_px, seed):
    """Return filtered noise over all grey levels."""
    rng = np.random.default_rng([2, seed])
    grey = cv2.GaussianBlur(rng.standard_normal(size_px[::-1]), (0, 0), scale_px)
    return np.clip(128 + 80 * grey / grey.std(), 0, 255).astype(np.uint8)


def noise(size_px, seed):
    return np.random.default_rng([3, seed]).integers(0, 256, size_px[::-1], dtype=np.uint8)


IMAGES = {
    "markers": lambda: markers((900, 700), 60, 0.0, 1),
    "markers with noise 5": lambda: markers((900, 700), 60, 5.0, 2),
    "few markers": lambda: markers((1280, 960), 6, 2.0, 3),
    "small markers": lambda: cv2.resize(
        markers((900, 700), 80, 5.0, 4), None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA
    ),
    "texture of 2 px": lambda: texture((640, 480), 2.0, 5),
    "texture of 5 px": lambda: texture((641, 483), 5.0, 6),
    "texture of 12 px": lambda: texture((640, 480), 12.0, 7),
    "noise": lambda: noise((640, 480), 8),
}


@lru_cache
def image_of(name):
    return IMAGES[name]()


def whole(image):
    """Return an image as the only place of a mosaic."""
    return Mosaic(
        image, np.full(np.array(image.shape) // 2, 255, np.uint8), np.zeros(1, int), np.zeros(1, complex)
    )


def clear_of_limit(quads, enlargement, min_side_px):
    """Return the quadrilaterals whose shortest side does not equal the limit, which rounding decides."""
    shortest = np.linalg.norm(np.roll(quads, -1, axis=1) - quads, axis=2).min(axis=1)
    limits = min_side_px * np.array(SHRINKS if enlargement == 1 else [1 / enlargement])
    return quads[np.abs(shortest[:, None] - limits).min(axis=1) > TOLERANCE_PX]


def assert_same_quads(found, expected, enlargement=1, min_side_px=MIN_QUAD_SIDE_PX):
    """Assert that two sets of quadrilaterals are equal, in any order and from any first corner."""
    found, expected = (clear_of_limit(quads, enlargement, min_side_px) for quads in (found, expected))
    assert len(found) == len(expected)
    if not len(found):
        return
    turned = np.stack([np.roll(found, turn, axis=1) for turn in range(4)])
    off = np.abs(turned[:, :, None] - expected[None, None]).max(axis=(3, 4)).min(axis=0)
    rows, columns = linear_sum_assignment(np.minimum(off, 1.0))
    assert off[rows, columns].max() <= TOLERANCE_PX, np.sort(off[rows, columns])[-5:]


@pytest.mark.parametrize("name", IMAGES)
def test_find_quads_equals_reference(name):
    image = image_of(name)
    assert_same_quads(find_quads(image), reference.find_quads(image))


@pytest.mark.parametrize("name", IMAGES)
def test_small_quads_equal_reference(name):
    places = crowded_places(image_of(name))
    if places is not None:
        assert_same_quads(small_quads(places), reference.small_quads(places), ENLARGEMENT)


@pytest.mark.parametrize("name", IMAGES)
def test_faint_quads_equal_reference(name):
    image, known = image_of(name), np.zeros((0, 4, 2))
    found = find_faint_quads(image, known, image_noise(image))
    assert_same_quads(found, reference.find_faint_quads(image, known, image_noise(image)))


def test_images_of_markers_have_many_quads():
    """The comparisons above would pass on two empty sets."""
    assert len(find_quads(image_of("markers with noise 5"))) > 60
    assert len(small_quads(crowded_places(image_of("small markers")))) > 60


@pytest.mark.parametrize("enlargement", [1, ENLARGEMENT])
def test_quads_of_small_images_equal_reference(enlargement, monkeypatch):
    """Windows wider than the image are mirrored several times. Low limits let small regions count."""
    parameters, found = search_parameters(range(1), enlargement), 0
    parameters.min_side_px, parameters.min_points = 3.0, 8
    parameters.min_area_px2, parameters.min_compactness = 4.0, 0.0
    monkeypatch.setattr(reference, "MIN_QUAD_SIDE_PX", 3.0)
    monkeypatch.setattr(reference, "MIN_COMPACTNESS", 0.0)
    for height in range(2, 50, 2):
        for width in range(2, 50, 2):
            places = whole(markers((width, height), 2, 2.0, 100 * height + width))
            searched = places if enlargement == 1 else reference.enlarged(places)
            boundaries = reference.dark_boundaries(reference.dark_regions(searched), 8)
            expected = reference._quads_of(boundaries, GROWTH_PX, min_area_px2=4.0)
            quads, _ = library().quads(places.image, places.mask, parameters)
            assert_same_quads(quads, expected, min_side_px=3.0)
            found += len(expected) * (min(height, width) <= 10)
    assert found > 100


BLOCKS = np.zeros((2, 2, 2), np.float32)


@pytest.mark.parametrize("size", [(90, 61), (64, 48), (5, 4), (4, 39)])
def test_stretched_images_equal_opencv(size):
    """Gains and shifts enlarged by OpenCV, which has no incomplete blocks; all builds give equal bytes."""
    rng = np.random.default_rng([10, *size])
    image, blocks = rng.integers(0, 256, size, dtype=np.uint8), (size[0] // 4, size[1] // 4)
    gains, shifts = rng.uniform(0, 9, (2, *blocks)), rng.uniform(-400, 200, (2, *blocks))
    gains, shifts = gains.astype(np.float32), shifts.astype(np.float32)
    is_sharp = np.where(rng.random(blocks) < 0.5, 255, 0).astype(np.uint8)
    made = [other.stretched(image, gains, shifts, is_sharp) for other in builds("vision", declared).values()]
    assert len({one[0].tobytes() + one[1].tobytes() for one in made}) == 1
    height, width = 4 * blocks[0], 4 * blocks[1]
    smooth = cv2.GaussianBlur(image, (3, 3), 0)[:height, :width]
    chosen = np.where(np.kron(is_sharp, np.ones((4, 4), np.uint8)) > 0, image[:height, :width], smooth)
    for levels, gain, shift, one in zip((chosen, smooth), gains, shifts, made[0], strict=True):
        gain, shift = (cv2.resize(part, (width, height)).astype(float) for part in (gain, shift))
        expected = np.clip(gain * levels + shift, 0, 255)
        assert np.abs(one[:height, :width] - expected).max() < 0.501
        assert min(size) < 10 or np.isin(one, [0, 255], invert=True).mean() > 0.1


@pytest.mark.parametrize("name", IMAGES)
def test_builds_give_equal_bytes(name):
    places = whole(image_of(name)[:350, :450].copy())
    image, places = places.image, places.mask
    results = [
        other.quads(image, places, search_parameters(range(3)))
        for other in builds("vision", declared).values()
    ]
    assert {corners.tobytes() for corners, _ in results} == {results[0][0].tobytes()}


@pytest.mark.parametrize(
    "image, places",
    [
        (np.zeros((4, 4)), np.zeros((2, 2), np.uint8)),
        (np.zeros((4, 5), np.uint8), np.zeros((2, 2), np.uint8)),
        (np.zeros((4, 8), np.uint8)[:, ::2], np.zeros((2, 2), np.uint8)),
        (np.zeros((4, 4), np.uint8), np.zeros((2, 3), np.uint8)),
        (np.zeros((4, 4, 1), np.uint8), np.zeros((2, 2), np.uint8)),
        (None, np.zeros((2, 2), np.uint8)),
    ],
    ids=["float", "odd width", "strided", "other places", "three axes", "none"],
)
def test_invalid_arrays_are_rejected(image, places):
    with pytest.raises(InputError):
        library().quads(image, places, PLAIN)


@pytest.mark.parametrize(
    ("gains", "shifts", "is_sharp"),
    [
        (np.zeros((2, 2, 2)), np.zeros((2, 2, 2)), np.zeros((2, 2), np.uint8)),
        (BLOCKS, np.zeros((2, 2, 1), np.float32), np.zeros((2, 2), np.uint8)),
        (BLOCKS, BLOCKS, np.zeros((2, 2))),
        (BLOCKS, BLOCKS, np.zeros((3, 2), np.uint8)),
        (np.zeros((2, 3, 2), np.float32), np.zeros((2, 3, 2), np.float32), np.zeros((3, 2), np.uint8)),
        (BLOCKS[:, :0], BLOCKS[:, :0], np.zeros((0, 2), np.uint8)),
    ],
    ids=["double", "other shape", "sharp as double", "other blocks", "beyond the image", "none"],
)
def test_invalid_blocks_are_rejected(gains, shifts, is_sharp):
    with pytest.raises(InputError):
        library().stretched(np.zeros((8, 8), np.uint8), gains, shifts, is_sharp)


@pytest.mark.parametrize(("name", "value"), [("small_window_px", 7), ("enlargement", 3)])
def test_window_or_enlargement_not_compiled_is_rejected(name, value):
    parameters = search_parameters(range(2))
    setattr(parameters, name, value)
    with pytest.raises(InputError, match="windows of 3, 5, 9 and 21 px"):
        library().quads(np.zeros((4, 4), np.uint8), np.zeros((2, 2), np.uint8), parameters)


def test_wide_mosaic_of_a_large_image_is_searched():
    """Many places of a large image form a mosaic wider than 32767 px, the limit of 16 bits."""
    image = np.tile(np.ascontiguousarray(image_of("markers")[:64, :600]), (1, 70))
    places = whole(image)
    assert len(library().quads(places.image, places.mask, PLAIN)[0]) > 0


@pytest.mark.parametrize(("room", "regions"), [(20, 5), (2000, 1), (0, 0)])
def test_boundaries_beyond_the_room_are_an_error(room, regions):
    """Two dark squares of 20 px have 76 points each; nothing is written behind the room."""
    image = np.full((60, 100), 200, np.uint8)
    image[20:40, 10:30] = image[20:40, 60:80] = 20
    assert [len(one) for one in library().large_boundaries(image, 8, 10)] == [76, 76]
    points, counts = np.full((room + 1000, 2), -7, np.int32), np.full(regions + 9, -7, np.int32)
    memory = np.zeros(library().functions.search_workspace_bytes(100, 60), np.uint8)
    given = image.ctypes.data, 100, 60, 8, 10, memory.ctypes.data, memory.size
    results = points.ctypes.data, room, counts.ctypes.data, regions
    assert library().functions.search_boundaries(*given, *results) == -3
    assert (points[room:] == -7).all() and (counts[regions:] == -7).all()
