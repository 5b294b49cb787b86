"""What a camera does to its images: each step against its formula, or another way to the same."""

import av
import cv2
import numpy as np
import pytest

from skyherd.errors import InputError
from skyherd.render import Mosaic, Processing, Sensor
from skyherd.render.processing.smoothing import REACH_PX, WINDOW_PX, denoise, sharpen
from skyherd.render.processing.tone import luma, raw_signal, tone
from skyherd.render.processing.video_stream import VideoStream

RAMP = np.add.outer(np.arange(60.0), 2 * np.arange(80.0)).astype(np.float32)
"""Grey levels that change from pixel to pixel, 60 x 80."""

FILTERS = [Mosaic("bilinear"), Mosaic("edge-aware"), Mosaic("edge-aware", 2.0, 1.5)]


def taken(light, processing=None, noise=0.0, seed=1, shot=0.0) -> np.ndarray:
    """Image that a sensor with this processing makes, as floats."""
    sensor = Sensor(noise, np.random.default_rng(seed), shot=shot, processing=processing or Processing())
    return sensor.expose(np.array(light, dtype=np.float32)).astype(float)


def test_a_gamma_is_undone_by_its_inverse():
    levels = np.linspace(0, 255, 400)
    np.testing.assert_allclose(tone(tone(levels, 2.2, 0.0), 1 / 2.2, 0.0), levels, atol=1e-9)
    np.testing.assert_allclose(tone(levels, 1.0, 0.0), levels, atol=1e-12)
    np.testing.assert_allclose(tone([0.0, 255.0], 2.2, 0.7), [0.0, 255.0], atol=1e-9)


def test_the_tone_curve_is_the_one_of_its_docstring():
    """By hand: half of the light under gamma 2 is sqrt 0.5, and S of it 3/2 - sqrt 0.5."""
    root = np.sqrt(0.5)
    assert tone(127.5, 2.0, 0.0) == pytest.approx(255 * root)
    assert tone(127.5, 2.0, 1.0) == pytest.approx(255 * (1.5 - root))
    for level in (10.0, 100.0, 230.0):
        image = taken(np.full((8, 8), level), Processing(gamma=2.2, s_curve=0.3))
        np.testing.assert_array_equal(image, np.rint(tone(level, 2.2, 0.3)))


@pytest.mark.parametrize("mosaic", FILTERS)
@pytest.mark.parametrize("size", [(40, 60), (41, 33)])
def test_flat_grey_stays_what_it_is_through_a_mosaic(mosaic, size):
    for level in (0.0, 17.0, 128.0, 255.0):
        np.testing.assert_array_equal(taken(np.full(size, level), Processing(mosaic=mosaic)), level)


@pytest.mark.parametrize("mosaic", FILTERS[:2])
def test_a_slope_stays_what_it_is_through_a_mosaic(mosaic):
    """Interpolation is exact on a plane, away from the image's rim; rounding to 8 bits is the only change."""
    image = taken(RAMP / 2, Processing(mosaic=mosaic))
    assert np.abs(image - RAMP / 2)[3:-3, 3:-3].max() <= 0.5 + 1 / 128


def test_bilinear_demosaicing_averages_nearest_of_each_colour():
    """Another way: each colour's pixels, convolved with a tent, over as much of the tent as has pixels."""
    raw = raw_signal(np.random.default_rng(4).uniform(0, 255, (20, 24)).astype(np.float32))
    tent = np.array([[1, 2, 1], [2, 4, 2], [1, 2, 1]]) / 4
    cross = np.array([[0, 1, 0], [1, 4, 1], [0, 1, 0]]) / 4
    v, u = np.mgrid[:20, :24]
    red, blue = (v % 2 == 0) & (u % 2 == 0), (v % 2 == 1) & (u % 2 == 1)
    planes = [(blue, tent), (~red & ~blue, cross), (red, tent)]
    expected = [cv2.filter2D(np.where(at, raw, 0).astype(float), -1, kernel) for at, kernel in planes]
    found = Mosaic("bilinear").interpolate(raw).astype(float)
    np.testing.assert_allclose(found[2:-2, 2:-2], np.stack(expected, axis=-1)[2:-2, 2:-2], atol=1)


@pytest.mark.parametrize("gains", [(1.0, 1.0), (2.0, 1.5)])
def test_white_balance_multiplies_noise_before_the_mosaic(gains):
    """The variance of luma from those of the mosaic's pixels, g² noise² + g shot s, at its four places.

    A colour is that of the pixel itself, or the mean of two or four neighbours. 160 000 pixels, whose errors
    depend on some ten neighbours each: five standard errors are 5 sqrt(2 · 10 / 160 000), 6 %.
    """
    noise, shot, level = 6.0, 0.2, 128.0
    settings = Processing(mosaic=Mosaic("bilinear", *gains))
    image = taken(np.full((400, 400), level), settings, noise=noise, shot=shot)[4:-4, 4:-4]
    red, green, blue = (g * g * noise**2 + g * shot * level for g in (gains[0], 1.0, gains[1]))
    averaged = {"red": (1, 4, 4), "green in red's row": (2, 1, 2), "in blue's": (2, 1, 2), "blue": (4, 4, 1)}
    expected = np.mean(
        [
            0.299**2 * red / of_red + 0.587**2 * green / of_green + 0.114**2 * blue / of_blue
            for of_red, of_green, of_blue in averaged.values()
        ]
    )
    assert image.var() == pytest.approx(expected + 1 / 12, rel=0.06)
    neighbours = np.corrcoef(image[:, 1:].ravel(), image[:, :-1].ravel())[0, 1]
    assert neighbours > 0.2, "errors of neighbours depend on each other, as those of the sensor do not"


def test_filters_lie_in_fours():
    np.testing.assert_array_equal(FILTERS[2].gains(3, 4), [[2, 1, 2, 1], [1, 1.5, 1, 1.5], [2, 1, 2, 1]])


def test_the_information_of_a_mosaic_is_that_of_its_pixels():
    assert Mosaic().information == Mosaic("bilinear").information == 1.0
    gains = FILTERS[2].gains(10, 10)
    assert FILTERS[2].information == pytest.approx((gains**-2.0).mean())


def test_denoising_is_the_bilateral_filter_of_its_docstring():
    """Pixel by pixel in the inner part; OpenCV reads its weights off a table, and its window is round."""
    image = np.random.default_rng(2).normal(120, 12, (16, 18)).astype(np.float32)
    image[:, 9:] += 60
    reach = WINDOW_PX // 2
    found = denoise(image, 15.0)
    steps = [(i, j) for i in range(-reach, reach + 1) for j in range(-reach, reach + 1)]
    steps = [(i, j) for i, j in steps if np.hypot(i, j) <= reach]
    for v, u in ((5, 5), (8, 8), (9, 9), (10, 12)):
        near = np.array([image[v + i, u + j] for i, j in steps], dtype=float)
        square = np.array([i * i + j * j for i, j in steps])
        weights = np.exp(-square / (2 * REACH_PX**2) - (near - image[v, u]) ** 2 / (2 * 15.0**2))
        assert found[v, u] == pytest.approx(weights @ near / weights.sum(), abs=0.02)
    assert found[4:-4, :7].std() < 0.7 * image[4:-4, :7].std()
    assert found[:, 11:].mean() - found[:, :7].mean() == pytest.approx(60, abs=6), "the edge stays"


def test_sharpening_is_an_unsharp_mask():
    """On a wave of frequency w a Gaussian leaves g = exp(-(w s)²/2), so that it grows by 1 + a (1 - g)."""
    frequency, amount, radius = 2 * np.pi / 8, 0.7, 1.3
    wave = np.tile(np.sin(frequency * np.arange(160)), (40, 1)).astype(np.float32)
    grown = sharpen(wave, amount, radius)[20, 20:-20] @ wave[20, 20:-20] / (wave[20, 20:-20] ** 2).sum()
    expected = 1 + amount * (1 - np.exp(-((frequency * radius) ** 2) / 2))
    assert grown == pytest.approx(expected, rel=2e-3)
    np.testing.assert_array_equal(sharpen(wave, 0.0, radius), wave)


def test_the_steps_come_in_the_order_they_are_described_in():
    processing = Processing(
        mosaic=FILTERS[1], gamma=1.8, s_curve=0.2, denoise=9.0, sharpen=0.5, sharpen_px=0.8
    )
    light = np.random.default_rng(3).uniform(0, 255, (50, 60)).astype(np.float32)
    colours = cv2.demosaicing(np.rint(256 * light).astype(np.uint16), cv2.COLOR_BayerRGGB2BGR_EA)
    grey = tone(colours / 256, 1.8, 0.2) @ [0.114, 0.587, 0.299]
    smooth = denoise(grey.astype(np.float32), 9.0)
    expected = np.clip(sharpen(smooth, 0.5, 0.8), 0, 255)
    assert np.abs(processing.develop(light) - expected).max() <= 0.51


def test_luma_weighs_colours_as_jpeg_does():
    raw = np.zeros((1, 3, 3), dtype=np.uint16)
    raw[0, np.arange(3), np.arange(3)] = 100 * 256
    np.testing.assert_allclose(luma(raw, 1.0, 0.0)[0], [11.4, 58.7, 29.9], atol=1e-4)


def textured(number: int) -> np.ndarray:
    """A picture of a smooth pattern that moves from picture to picture, with noise; 45 x 65, odd."""
    v, u = np.mgrid[:45, :65]
    wave = 120 + 60 * np.sin((u + number) / 5.0) * np.cos((v - number) / 7.0)
    return np.clip(wave + np.random.default_rng(number).normal(0, 3, wave.shape), 0, 255).astype(np.uint8)


def test_video_returns_pictures_in_order_and_equal_bits():
    """Closest to its own picture among all; more loss and fewer bits at a higher factor."""
    sent = [textured(4 * number) for number in range(8)]
    sizes, losses = [], []
    for crf in (10, 30):
        streams = VideoStream((65, 45), crf), VideoStream((65, 45), crf)
        one, again = ([stream.send(picture) for picture in sent] for stream in streams)
        np.testing.assert_array_equal(one, again)
        away = np.abs(np.subtract.outer(np.array(one, float), 0)[:, None] - np.array(sent, float)[None])
        away = away.mean(axis=(2, 3))
        np.testing.assert_array_equal(away.argmin(axis=1), range(8))
        losses.append(np.diag(away).mean())
        sizes.append(streams[0].bits)
        assert streams[0].pictures == 8
    assert losses[0] < losses[1] and sizes[0] > 1.5 * sizes[1]


def test_a_video_is_h264_that_any_decoder_reads(tmp_path):
    """Its packets in a file, read by a demuxer and another decoder: the same pictures."""
    stream = VideoStream((64, 48), 23)
    packets = []
    encode = stream._encoder.encode

    class Spy:
        width, height = stream._encoder.width, stream._encoder.height

        def encode(self, picture):
            packets.extend(made := encode(picture))
            return made

    stream._encoder = Spy()
    seen = [stream.send(textured(number)[:44, :64].repeat(2, 0)[:48]) for number in range(4)]
    path = tmp_path / "stream.h264"
    path.write_bytes(b"".join(bytes(packet) for packet in packets))
    with av.open(str(path)) as container:
        read = [frame.to_ndarray(format="yuvj420p")[:48] for frame in container.decode(video=0)]
    np.testing.assert_array_equal(read, seen)


def test_each_camera_has_a_video_of_its_own():
    """Pictures of two cameras in turn come out as those of each alone; a shared stream would mix them up."""
    settings = Processing(h264_crf=28)
    both = Sensor(0.0, np.random.default_rng(0), processing=settings)
    alone = [Sensor(0.0, np.random.default_rng(0), processing=settings) for _ in range(2)]
    for number in range(3):
        for camera in range(2):
            picture = textured(number + 20 * camera)
            np.testing.assert_array_equal(
                both.expose(picture.copy(), camera), alone[camera].expose(picture.copy())
            )


def test_jpeg_comes_after_development_and_before_the_video():
    settings = Processing(gamma=2.0, h264_crf=20)
    sensor = Sensor(0.0, np.random.default_rng(0), jpeg_quality=30, processing=settings)
    _, data = cv2.imencode(".jpg", settings.develop(RAMP), [cv2.IMWRITE_JPEG_QUALITY, 30])
    expected = VideoStream((80, 60), 20).send(cv2.imdecode(data, cv2.IMREAD_GRAYSCALE))
    np.testing.assert_array_equal(sensor.expose(RAMP.copy()), expected)


ON = {
    "mosaic": FILTERS[2],
    "gamma": 1.5,
    "s_curve": 0.5,
    "denoise": 10.0,
    "sharpen": 0.5,
    "h264_crf": 25,
}


@pytest.mark.parametrize("part", ON)
def test_each_part_changes_the_image_alone_and_is_off_by_one_key(part):
    """All off is what a sensor without processing gives, bit by bit, under noise too."""
    plain = taken(RAMP, None, noise=3.0, shot=0.1)
    off = Processing(sharpen_px=2.0)
    np.testing.assert_array_equal(taken(RAMP, off, noise=3.0, shot=0.1), plain)
    on = taken(RAMP, Processing(**{part: ON[part]}), noise=3.0, shot=0.1)
    assert (on != plain).mean() > 0.2
    everything, all_but = Processing(**ON), Processing(**{k: v for k, v in ON.items() if k != part})
    assert (taken(RAMP, everything, 3.0) != taken(RAMP, all_but, 3.0)).mean() > 0.2


def test_equal_seeds_give_equal_images_and_others_do_not():
    settings = Processing(**ON)
    one, same, other = (taken(RAMP, settings, noise=3.0, seed=seed) for seed in (1, 1, 2))
    np.testing.assert_array_equal(one, same)
    assert (one != other).mean() > 0.2


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: Processing(gamma=0.0), "gamma: 0; allowed: from 0.2 to 5"),
        (lambda: Processing(s_curve=1.1), "s_curve: 1.1"),
        (lambda: Processing(sharpen=-1.0), "sharpen: -1"),
        (lambda: Processing(h264_crf=52), "h264_crf: 52; allowed: from 0 to 51, or none"),
        (lambda: Mosaic("nearest"), "demosaic: 'nearest'"),
        (lambda: Mosaic("bilinear", 0.5), "white balance: red 0.5"),
    ],
)
def test_settings_out_of_range_are_refused_in_one_line(make, words):
    with pytest.raises(InputError) as error:
        make()
    assert words.split("; allowed")[0] in str(error.value) and "\n" not in str(error.value)
