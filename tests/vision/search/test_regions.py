"""Adaptive threshold: the mosaic gives the boundaries of the whole image; density limit and exclusions."""

import cv2
import numpy as np
import pytest
from search_reference import dark_boundaries, dark_regions, enlarged

from skyherd.vision.search import regions
from skyherd.vision.search.quads import ENLARGEMENT, MIN_POINTS
from skyherd.vision.search.regions import crowded_places

SIZE_PX = (900, 700)


def drawn(shapes, noise=3.0, ground=150):
    """Return an image of dark polygons (K, 2) on larger light cards, on grey, with blur and noise."""
    image = np.full(SIZE_PX[::-1], ground, np.uint8)
    for scale, grey in ((1.4, 230), (1.0, 30)):
        for corners in shapes:
            middle = corners.mean(axis=0)
            points = np.rint(16 * (middle + scale * (corners - middle))).astype(np.int32)
            cv2.fillPoly(image, [points], grey, cv2.LINE_AA, 4)
    rng = np.random.default_rng(0)
    image = cv2.GaussianBlur(image, (0, 0), 0.8) + noise * rng.standard_normal(image.shape)
    return np.clip(np.rint(image), 0, 255).astype(np.uint8)


def squares(seed, *, count=10):
    """Return the corners of squares of 12-40 px; every third is at the image border."""
    rng = np.random.default_rng(seed)
    corners = []
    for row in range(count):
        side, turn = rng.uniform(12, 40), np.exp(1j * rng.uniform(-np.pi, np.pi))
        middle = complex(*(rng.uniform(40, np.array(SIZE_PX) - 40)))
        if row % 3 == 0:
            middle = complex(rng.choice([side, SIZE_PX[0] - side]), middle.imag)
        z = middle + side * turn * np.array([-1 - 1j, 1 - 1j, 1 + 1j, -1 + 1j]) / 2
        corners.append(np.column_stack([z.real, z.imag]))
    return corners


def bars(*, apart):
    """Return two parallel slanted bars whose bounding boxes overlap."""
    bar = np.array([[100, 100], [112, 92], [312, 342], [300, 350]], dtype=float)
    return [bar, bar + np.array([apart, 0])]


def boundaries_of(image):
    """Return every boundary as a sorted tuple of its points, in sorted order."""
    found = dark_boundaries(dark_regions(crowded_places(image)), MIN_POINTS)
    parts = np.split(found.points, np.cumsum(found.lengths)[:-1]) if found.lengths.size else []
    return sorted(tuple(sorted((z.real, z.imag) for z in part)) for part in parts)


SCENES = {f"squares {seed}": squares(seed) for seed in range(4)} | {"bars": bars(apart=70)}


@pytest.mark.parametrize("shapes", SCENES.values(), ids=SCENES)
def test_mosaic_gives_the_boundaries_of_the_whole_image(shapes, monkeypatch):
    """The boundaries are identical, because the margin of a place covers the reach of the box filters."""
    image = drawn(shapes)
    apart = boundaries_of(image)
    monkeypatch.setattr(regions, "MAX_MOSAIC_SHARE", 0.0)
    assert len(apart) >= len(shapes)
    assert apart == boundaries_of(image)


def test_too_narrow_margin_changes_the_boundaries(monkeypatch):
    """Negative control for the test above."""
    image = drawn(SCENES["squares 1"])
    apart = boundaries_of(image)
    monkeypatch.setattr(regions, "MARGIN_PX", 2)
    assert apart != boundaries_of(image)


def test_few_places_form_a_mosaic_and_many_the_whole_image():
    few, many = drawn(squares(5, count=4)), drawn(squares(6, count=120))
    assert crowded_places(few).image.size < few.size / 4
    assert crowded_places(many).image.shape == many.shape


def test_min_darkness_excludes_texture():
    """A texture of 5 grey levels over a few pixels has many slightly dark places."""
    rng = np.random.default_rng(8)
    texture = cv2.GaussianBlur(rng.standard_normal(SIZE_PX[::-1]), (0, 0), 2.0)
    shapes = squares(5, count=4)
    image = np.clip(drawn(shapes) + 5 * texture / texture.std(), 0, 255).astype(np.uint8)
    assert crowded_places(image).image.shape == image.shape
    few = crowded_places(image, min_darkness=5.0)
    assert few.image.size < image.size / 4
    middles = middles_of(few)
    assert all(np.abs(middles - complex(*corners.mean(axis=0))).min() < 1 for corners in shapes)


@pytest.mark.parametrize("noise", [2.0, 5.0, 10.0])
def test_pure_noise_is_below_the_density_limit(noise):
    """The mean darkness of noise is 0.4 σ, with a standard deviation of 0.12 σ over 25 pixels.

    A factor of 2.2 is four standard deviations, which 3e-5 of the pixels exceed. Dilation multiplies them by
    81, to 0.25 %. The limit is ten times as much, because neighbouring pixels are correlated.
    """
    rng = np.random.default_rng(7)
    image = np.clip(np.rint(rng.normal(128, noise, (600, 800))), 0, 255).astype(np.uint8)
    assert (regions._crowded(image, np.zeros((0, 4, 2)), 0.0) > 0).mean() < 0.025


@pytest.mark.parametrize("size_px", [(1, 1), (1, 7), (7, 1), (2, 2), (3, 5), (33, 47)])
def test_images_of_any_size_are_accepted(size_px):
    """The boundary of a pixel is too short. An odd last row or column is ignored."""
    places = crowded_places(np.zeros(size_px[::-1], np.uint8))
    assert places is None or not dark_boundaries(dark_regions(places), MIN_POINTS).lengths.size


def test_boundary_lies_on_the_region_and_runs_anticlockwise():
    """An upright square of 20 px at (300, 200): the outermost dark pixels are within 1 px of its edges."""
    square = np.array([[300, 200], [320, 200], [320, 220], [300, 220]], dtype=float)
    places = crowded_places(drawn([square], noise=0.0, ground=230))
    found = dark_boundaries(dark_regions(places), MIN_POINTS)
    outer = found.points[: found.lengths[0]]
    assert found.lengths.size == 1
    assert abs(outer.real.min() - 300) <= 1 and abs(outer.real.max() - 320) <= 1
    assert abs(outer.imag.min() - 200) <= 1 and abs(outer.imag.max() - 220) <= 1
    assert (outer.conj() * np.roll(outer, -1)).imag.sum() < 0


def middles_of(mosaic):
    """Return the mean (B,) of every boundary in a mosaic, u + iv, px."""
    found = dark_boundaries(dark_regions(mosaic), MIN_POINTS)
    return np.array([part.mean() for part in np.split(found.points, np.cumsum(found.lengths)[:-1])])


def test_known_squares_are_excluded_and_neighbours_kept():
    """Eight of nine squares, 6 px apart, are known: the places contain the whole edge of the ninth."""
    at = np.array([[u, v] for u in (200, 222, 300) for v in (200, 222, 300)], dtype=float)
    shapes = at[:, None] + 8 * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    image = drawn(shapes, noise=0.0, ground=230)
    assert crowded_places(image, shapes) is None
    for row, (u, v) in enumerate(at):
        places = crowded_places(image, np.delete(shapes, row, axis=0))
        assert np.abs(middles_of(places) - complex(u, v)).min() < 0.5
        assert places.image.size < crowded_places(image).image.size


def test_enlarged_mosaic_has_the_same_squares():
    """The means of the boundaries agree to half a pixel of the image in both."""
    shapes = squares(2)
    places = crowded_places(drawn(shapes, noise=0.0))
    in_image = (middles_of(enlarged(places)) + 0.5 + 0.5j) / ENLARGEMENT - 0.5 - 0.5j
    own = middles_of(places)
    for shape in shapes:
        middle = complex(*shape.mean(axis=0))
        if np.abs(own - middle).min() < 0.5:
            assert np.abs(in_image - middle).min() < 0.5
