"""Ground: position, band limit, lens, rolling shutter and clutter."""

from functools import lru_cache

import numpy as np
import pytest

from skyherd.errors import InputError
from skyherd.render import (
    Camera,
    CameraPose,
    Clutter,
    Distortion,
    Ground,
    Motion,
    Renderer,
    Sensor,
    Shot,
    Shutter,
    homography_image_ground,
    project,
)
from skyherd.render import ground as ground_module
from skyherd.render.scene.textures import LONGEST_WAVES, PERIOD, concrete_spectrum


def test_ground_is_fixed_under_a_moving_camera() -> None:
    """A camera motion of whole pixels shifts the image by the same number of pixels.

    Bilinear sampling at the same sub-sample phase gives the same value. Each image is rounded by at most half
    a grey level.
    """
    ground = Ground(3, contrast=20.0)
    camera = Camera((300, 300), 320.0)  # 40 px/m at 8 m
    draw = [
        ground.draw(homography_image_ground(camera, CameraPose((x, 1.0), 8.0)), (300, 300)).astype(float)
        for x in (1.0, 1.5)
    ]
    difference = draw[0][:, 20:] - draw[1][:, :-20]
    assert np.abs(difference).max() <= 1.0
    assert draw[0].std() > 5


def seen(ground: Ground, camera: Camera, pose: CameraPose) -> np.ndarray:
    return ground.draw(homography_image_ground(camera, pose), camera.size_px).astype(float)


def test_ground_picture_has_north_at_its_top():
    """North is at the top and east at the right. The picture is 8 m wide and 4 m high."""
    picture = np.full((100, 200), 60, np.uint8)
    picture[:50, 100:], picture[50:, 100:] = 200, 120
    ground = Ground(0, kind="image", image=picture, tile_m=8.0)
    camera, pose = Camera((320, 160), 40.0), CameraPose((4.0, 2.0), 1.0)
    image = seen(ground, camera, pose)
    np.testing.assert_allclose(image[20:60, 180:300], 200, atol=2)
    np.testing.assert_allclose(image[100:140, 180:300], 120, atol=2)
    for part in (image[20:60, 20:140], image[100:140, 20:140]):
        np.testing.assert_allclose(part, 60, atol=2)


def test_tile_joints_have_the_tile_period():
    """Tiles of 0.5 m at 100 px/m have a joint every 50 px, 0.7 px inside a tile."""
    ground = Ground(1, kind="tiles", tile_m=0.5, contrast=10.0)
    row = seen(ground, Camera((420, 40), 100.0), CameraPose((2.0, 0.25), 1.0)).mean(axis=0)
    depth = np.minimum(row[:-16], row[16:]) - row[8:-8]
    joints = 8 + np.flatnonzero((depth > 6) & (depth >= np.roll(depth, 1)) & (depth >= np.roll(depth, -1)))
    assert len(joints) >= 7, "one between a light and a dark tile may be missed"
    np.testing.assert_allclose((joints - 10.2 + 25) % 50 - 25, 0, atol=1.5)


@pytest.mark.parametrize("kind", ["concrete", "tiles"])
def test_far_ground_is_grey_and_does_not_alias(kind):
    """At a period of a few pixels only the mean of the texture remains."""
    ground = Ground(1, kind=kind, tile_m=1.0, contrast=20.0)
    period_m = ground.period_m[0]
    image = seen(ground, Camera((200, 200), 6.0 / period_m), CameraPose((0.3, 0.1), 1.0))
    near = seen(ground, Camera((200, 200), 600.0 / period_m), CameraPose((0.3, 0.1), 1.0))
    assert near.std() > 8
    assert image.std() < 3
    assert image.mean() == pytest.approx(near.mean(), abs=8)


def test_cached_ground_is_not_changed_by_drawing():
    ground, camera, pose = Ground(2), Camera((100, 80), 50.0), CameraPose((0.0, 0.0), 2.0)
    first = seen(ground, camera, pose)
    for _ in range(3):
        drawn = ground.draw(homography_image_ground(camera, pose), camera.size_px)
        np.testing.assert_array_equal(drawn, first)
        drawn[:] = 0


def test_ground_is_distorted_by_the_lens():
    """Grey levels equal those of the undistorted image at the corresponding points."""
    lens = Distortion(k1=-0.2, p1=0.003)
    ground = Ground(3, contrast=15.0)
    plain, bent = Camera((240, 200), 200.0), Camera((240, 200), 200.0, distortion=lens)
    pose = CameraPose((1.0, 2.0), 8.0, 0.3, (0.1, 0.0))
    sensor = Sensor(0.0, np.random.default_rng(0))
    renderer = Renderer("4X4_50", 1.0, ground, sensor)
    none = np.zeros(0, dtype=int), np.zeros((0, 2)), np.zeros(0)
    straight, curved = (renderer.render(Shot(c, pose, *none)).astype(float) for c in (plain, bent))
    v, u = np.mgrid[20:180:7, 20:220:7]
    points = np.stack([u, v], axis=-1).reshape(-1, 2)
    grid = footprint_points(plain, pose, points)
    at = project(bent, pose, grid)
    inside = ((at > 1) & (at < [238, 198])).all(axis=1)
    found = bilinear(curved, at[inside])
    np.testing.assert_allclose(found, straight[points[inside, 1], points[inside, 0]], atol=4)
    assert np.corrcoef(found, straight[points[inside, 1], points[inside, 0]])[0, 1] > 0.99


def footprint_points(camera: Camera, pose: CameraPose, pixels: np.ndarray) -> np.ndarray:
    """Return the ground points (N, 2) at pixels (N, 2)."""
    mapped = (
        np.column_stack([pixels, np.ones(len(pixels))])
        @ np.linalg.inv(homography_image_ground(camera, pose)).T
    )
    return mapped[:, :2] / mapped[:, 2:]


def bilinear(image: np.ndarray, at: np.ndarray) -> np.ndarray:
    u, v = np.floor(at).astype(int).T
    du, dv = (at - np.floor(at)).T
    upper = image[v, u] * (1 - du) + image[v, u + 1] * du
    lower = image[v + 1, u] * (1 - du) + image[v + 1, u + 1] * du
    return upper * (1 - dv) + lower * dv


def test_rolling_ground_rows_have_their_own_times():
    """The tolerance of 1 allows for the rounding of both images, which interpolate the same samples."""
    camera, pose, ground = (
        Camera((160, 120), 150.0),
        CameraPose((0.1, 0.0), 5.0, 0.3),
        Ground(4, contrast=20.0),
    )
    motion, none = Motion((2.0, 1.0, 0.0), 0.5), (np.zeros(0, dtype=int), np.zeros((0, 2)), np.zeros(0))

    def render(shutter: Shutter, at: CameraPose) -> np.ndarray:
        sensor = Sensor(0.0, np.random.default_rng(0))
        return (
            Renderer("4X4_50", 1.0, ground, sensor, shutter=shutter)
            .render(Shot(camera, at, *none, motion=motion))
            .astype(float)
        )

    rolling = render(Shutter(row_time_s=3e-4), pose)
    for v in (0, 31, 60, 119):
        still = render(Shutter(), motion.pose_at(pose, 3e-4 * (v - 59.5)))
        np.testing.assert_allclose(rolling[v], still[v], atol=1)


def test_clutter_has_its_density_and_is_fixed_to_the_ground():
    """The count is about Poisson (σ 12 of 150). A larger box contains all quads of a smaller one."""
    clutter = Clutter(7, density_per_m2=150 / 400, side_m=(0.4, 0.9))
    box = np.zeros(2), np.full(2, 20.0)
    counts = []
    for shift in range(10):
        corners, levels = clutter.within(box[0] + 57.0 * shift, box[1] + 57.0 * shift)
        centers = corners.mean(axis=1) - 57.0 * shift
        counts.append(int(((centers > 0) & (centers < 20)).all(axis=1).sum()))
    assert np.mean(counts) == pytest.approx(150, abs=5 * 12 / np.sqrt(10))
    assert (levels >= 10).all() and (levels <= 60).all()
    wide = clutter.within(box[0] - 5, box[1] + 5)[0]
    narrow = clutter.within(*box)[0]
    assert {tuple(c) for c in narrow.mean(axis=1)} <= {tuple(c) for c in wide.mean(axis=1)}
    plain = Ground(1, kind="plain", mean=150.0)
    covered = Ground(1, kind="plain", mean=150.0, clutter=clutter)
    camera, pose = Camera((400, 400), 200.0), CameraPose((10.0, 10.0), 10.0)
    none = np.zeros(0, dtype=int), np.zeros((0, 2)), np.zeros(0)
    sensor = Sensor(0.0, np.random.default_rng(0))
    bare, dark = (
        Renderer("4X4_50", 1.0, g, sensor).render(Shot(camera, pose, *none)) for g in (plain, covered)
    )
    assert (bare == 150).all()
    assert 0.05 < (dark < 70).mean() < 0.5


def test_invalid_ground_is_refused():
    with pytest.raises(InputError, match="kind 'sand'"):
        Ground(0, kind="sand")
    with pytest.raises(InputError, match="image"):
        Ground(0, kind="image")
    with pytest.raises(InputError, match="ground image"):
        Ground(0, kind="image", image=np.zeros((5, 5, 3), np.uint8))
    with pytest.raises(InputError, match="density_per_m2 0"):
        Clutter(0, 0, (1, 2))


def test_concrete_has_mean_contrast_and_a_falling_spectrum() -> None:
    """Power falls with the square of the frequency, and is zero up to `LONGEST_WAVES`.

    Rings of 16 to 18 and of 256 to 258 cycles have 107 and 1615 independent values, each with its mean as
    standard deviation; the limit is four standard deviations of the ratio.
    """
    spectrum = concrete_spectrum(5, 100.0, 8.0)
    image = np.fft.irfft2(spectrum)
    assert image.mean() == pytest.approx(100.0) and image.std() == pytest.approx(8.0)
    fy, fx = np.fft.fftfreq(PERIOD)[:, None] * PERIOD, np.fft.rfftfreq(PERIOD)[None, :] * PERIOD
    radius, power = np.hypot(fy, fx), np.abs(spectrum) ** 2
    assert not power[(radius > 0) & (radius <= LONGEST_WAVES)].any()
    scaled = [(power * radius**2)[(radius > low) & (radius < low + 2)].mean() for low in (16, 256)]
    assert scaled[0] == pytest.approx(scaled[1], rel=4 * (1 / 107 + 1 / 1615) ** 0.5)


def test_concrete_is_cached_by_seed_mean_and_contrast(monkeypatch) -> None:
    made = []

    def concrete_spectrum(*asked: float) -> np.ndarray:
        made.append(asked)
        return np.full((4, 3), sum(asked), dtype=complex)

    monkeypatch.setattr(ground_module, "concrete_spectrum", concrete_spectrum)
    monkeypatch.setattr(
        ground_module, "_concrete_spectrum", lru_cache(8)(ground_module._concrete_spectrum.__wrapped__)
    )
    each = [(1, 128.0, 12.0), (2, 128.0, 12.0), (1, 100.0, 12.0), (1, 128.0, 8.0)]
    grounds = [Ground(seed, mean=mean, contrast=contrast) for seed, mean, contrast in (*each, *each)]
    assert made == each
    sums = [kept._spectrum[0, 0].real for kept in grounds]
    assert sums == [sum(asked) for asked in (*each, *each)]
    with pytest.raises(ValueError, match="read-only"):
        grounds[0]._spectrum[0, 0] = 0
