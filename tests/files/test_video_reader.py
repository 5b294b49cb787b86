"""Videos are read upright, with the time stamps of their streams."""

import gc
from fractions import Fraction
from pathlib import Path

import av
import numpy as np
import pytest
from av.sidedata.sidedata import SideDataContainer
from video_tags import tag_display

from skyherd.errors import InputError, InputWarning
from skyherd.files.upright_grey import TAG_PX, UprightGrey
from skyherd.files.video_reader import open_clip, read_clip
from skyherd.files.video_writer import VideoSink, read_frames

UNEVEN_S = (0.0, 0.04, 0.2, 0.21, 0.9)
"""Uneven frame times, multiples of 0.01 s."""

LEVELS = np.kron(np.array([[30, 90], [150, 220]], np.uint8), np.ones((32, 48), np.uint8))
"""Picture (64, 96) whose quarters show its orientation."""

MATRICES = {
    "upright": ((1, 0, 0, 1), lambda image: image),
    "quarter turn clockwise": ((0, 1, -1, 0), lambda image: np.rot90(image, -1)),
    "half turn": ((-1, 0, 0, -1), lambda image: np.rot90(image, 2)),
    "quarter turn counter-clockwise": ((0, -1, 1, 0), lambda image: np.rot90(image)),
    "mirrored": ((-1, 0, 0, 1), lambda image: image[:, ::-1]),
    "upside down, mirrored": ((1, 0, 0, -1), lambda image: image[::-1]),
    "transposed": ((0, 1, 1, 0), lambda image: image.T),
    "transposed, half turn": ((0, -1, -1, 0), lambda image: np.rot90(image.T, 2)),
}
"""Display matrices (a, b, c, d) of MP4 files, and the picture's transformation by a player."""


def write(path, images, times_s=None, *, start_s=0.0):
    """Write a video of grey images at given times, by default 25 per second, and return its path."""
    times_s = np.arange(len(images)) / 25 if times_s is None else times_s
    with av.open(str(path), "w") as container:
        stream = container.add_stream("mpeg4", rate=25)
        stream.height, stream.width = images[0].shape
        stream.pix_fmt = "yuv420p"
        stream.codec_context.time_base = Fraction(1, 100)
        stream.bit_rate = 2_000_000
        for image, time_s in zip(images, times_s, strict=True):
            frame = av.VideoFrame.from_ndarray(np.ascontiguousarray(image), format="gray")
            frame = frame.reformat(format="yuv420p")
            frame.pts, frame.time_base = round(100 * (time_s + start_s)), Fraction(1, 100)
            container.mux(stream.encode(frame))
        container.mux(stream.encode(None))
    return path


@pytest.mark.smoke
@pytest.mark.parametrize("held", MATRICES)
def test_frames_match_player_orientation(tmp_path, held):
    matrix, shown = MATRICES[held]
    path = tag_display(write(tmp_path / "v.mp4", [LEVELS] * 2), matrix)
    expected = shown(LEVELS)
    for frame in read_clip(open_clip(path)):
        assert frame.image.shape == expected.shape and frame.image.flags.c_contiguous
        assert np.abs(frame.image.astype(int) - expected).mean() < 8


@pytest.mark.parametrize("name", ["v.mp4", "v.mkv"])
def test_times_are_stream_time_stamps(tmp_path, name):
    path = write(tmp_path / name, [LEVELS] * len(UNEVEN_S), UNEVEN_S)
    times = [frame.time_s for frame in read_clip(open_clip(path))]
    assert times == pytest.approx(UNEVEN_S, abs=0.002)
    even = np.arange(len(UNEVEN_S)) / float(open_clip(path).rate_hz)
    assert np.abs(even - UNEVEN_S).max() > 0.1


def test_late_stream_keeps_its_times(tmp_path):
    path = write(tmp_path / "v.mkv", [LEVELS] * 3, (0.0, 0.1, 0.3), start_s=2.0)
    assert [f.time_s for f in read_clip(open_clip(path))] == pytest.approx([2.0, 2.1, 2.3], abs=0.002)


def test_stream_without_times_uses_its_rate(tmp_path):
    """A raw MPEG-4 stream has no container, and so no times beyond its rate."""
    path = write(tmp_path / "v.m4v", [LEVELS] * 4)
    times = [frame.time_s for frame in read_clip(open_clip(path))]
    assert times == sorted(times) and len(set(times)) == 4


def test_written_times_are_read_back(tmp_path):
    """To 1e-4 s; a non-increasing time follows right after its predecessor."""
    path = tmp_path / "v.mp4"
    picture = np.repeat(LEVELS[..., None], 3, axis=2)
    times = [5.0, 5.02, 5.3, 5.3, 6.0]
    with VideoSink(path, (96, 64), 10, timed=True) as sink:
        for time_s in times:
            sink.write(picture, time_s)
    read = [frame.time_s for frame in read_clip(open_clip(path))]
    assert read == pytest.approx([0.0, 0.02, 0.3, 0.3, 1.0], abs=1e-4) and read[3] > read[2]
    with VideoSink(path, (96, 64), 10) as sink:
        for time_s in times:
            sink.write(picture, time_s)
    assert [f.time_s for f in read_clip(open_clip(path))] == pytest.approx(np.arange(5) / 10)
    assert len(list(read_frames(path))) == 5


FORMATS = [
    *("yuv420p", "yuvj420p", "yuv422p", "yuvj422p", "yuv444p", "nv12", "yuyv422", "gray", "rgb24", "bgr24"),
    *("gbrp", "yuv420p10le", "yuv422p10le", "p010le", "gray10le"),
]
"""Pixel formats of cameras and files: planar, packed, coloured, and ten bits."""

RANGES = {"not said": 0, "16 to 235": 1, "0 to 255": 2}
"""Ranges of grey levels, by FFmpeg's numbers."""


def coloured(form, levels, size_px=(802, 600)):
    """Return a decoded frame of noise and of colours in a pixel format and a range of levels."""
    width, height = size_px
    picture = np.random.default_rng(7).integers(0, 256, (height, width, 3), dtype=np.uint8)
    picture[: height // 2] = np.arange(width, dtype=np.uint32)[:, None] % 256
    frame = av.VideoFrame.from_ndarray(picture, format="rgb24").reformat(format=form)
    frame.color_range = levels
    return frame


@pytest.mark.parametrize("levels", RANGES.values(), ids=RANGES)
def test_grey_levels_match_ffmpeg(levels):
    """Bit-exact in each pixel format, although the converter is reused."""
    grey = UprightGrey()
    for form in FORMATS:
        frame = coloured(form, levels)
        assert np.array_equal(grey.of(frame), frame.to_ndarray(format="gray")), form


@pytest.mark.parametrize("size_px", [(2, 2), (TAG_PX, TAG_PX), (6, 4000), (4096, 2160)], ids=str)
def test_pictures_of_any_size_are_converted(size_px):
    frame = coloured("yuv420p", 2, size_px)
    assert np.array_equal(UprightGrey().of(frame), frame.to_ndarray(format="gray"))


@pytest.mark.skipif(not Path("/proc/self/task").is_dir(), reason="counts threads as Linux shows them")
def test_conversion_starts_no_thread():
    """Frames are kept, since conversion threads would last as long as their frame."""
    frames = [coloured(form, 1) for form in FORMATS]
    threads = {path.name for path in Path("/proc/self/task").iterdir()}
    grey = UprightGrey()
    for frame in frames:
        grey.of(frame)
    assert {path.name for path in Path("/proc/self/task").iterdir()} <= threads


def test_upright_frame_raises_no_pyav_error(monkeypatch):
    """A signal during a PyAV error is lost, so that Ctrl-C was sometimes ignored."""
    asked = []
    look_up = SideDataContainer.__getitem__
    monkeypatch.setattr(
        SideDataContainer, "__getitem__", lambda tags, key: asked.append(key) or look_up(tags, key)
    )
    frame = coloured("yuv420p", 2)
    assert frame.side_data.get("DISPLAYMATRIX") is None
    assert asked.pop() == "DISPLAYMATRIX"
    UprightGrey().of(frame)
    assert asked == []


@pytest.mark.parametrize("held", ["upright", "half turn"])
def test_frame_memory_is_released_with_its_image(tmp_path, held):
    """No reference cycle delays the release until garbage collection."""
    path = tag_display(write(tmp_path / "v.mp4", [LEVELS] * 12), MATRICES[held][0])
    gc.collect()
    gc.disable()
    try:
        assert sum(1 for _ in read_clip(open_clip(path))) == 12
        kept = [thing for thing in gc.get_objects() if type(thing) is av.VideoFrame]
        assert [frame for frame in kept if frame.width > TAG_PX] == []
    finally:
        gc.enable()


def noisy(count=30):
    """Return images of equal encoded size."""
    levels = np.random.default_rng(3).integers(0, 256, (count, 64, 96))
    return list(levels.astype(np.uint8))


@pytest.mark.parametrize("name", ["v.mkv", "v.avi"])
def test_truncated_video_is_read_with_warning(tmp_path, name):
    data = write(tmp_path / name, noisy()).read_bytes()
    whole = [frame.image for frame in read_clip(open_clip(tmp_path / name))]
    (tmp_path / name).write_bytes(data[: len(data) // 2])
    with pytest.warns(
        InputWarning, match=rf"{name}: cut short or damaged: 1\d frames, 0\.\d s of 1\.2 s$"
    ) as said:
        read = [frame.image for frame in read_clip(open_clip(tmp_path / name))]
    assert len(said) == 1 and len(whole) == 30
    assert all(np.array_equal(*pair) for pair in zip(read[:-1], whole, strict=False))


@pytest.mark.parametrize("name", ["v.mkv", "v.mp4"])
def test_damaged_video_is_read_with_warning(tmp_path, name):
    """Bytes in the middle are overwritten: earlier frames are unchanged."""
    data = bytearray(write(tmp_path / name, noisy()).read_bytes())
    whole = [frame.image for frame in read_clip(open_clip(tmp_path / name))]
    middle = slice(len(data) // 2, len(data) * 2 // 3)
    data[middle] = bytes(level ^ 0x5A for level in data[middle])
    (tmp_path / name).write_bytes(data)
    with pytest.warns(InputWarning, match=f"{name}: cut short or damaged: ") as said:
        read = [frame.image for frame in read_clip(open_clip(tmp_path / name))]
    assert len(said) == 1 and len(read) >= 12
    assert all(np.array_equal(*pair) for pair in zip(read[:12], whole, strict=False))


def test_late_or_uneven_video_gives_no_warning(tmp_path):
    """Warnings are errors in tests."""
    for name in ("v.mkv", "v.mp4", "v.avi"):
        path = write(tmp_path / name, noisy(5), None if name == "v.avi" else UNEVEN_S, start_s=2.0)
        assert sum(1 for _ in read_clip(open_clip(path))) == 5


def test_sound_file_is_rejected(tmp_path):
    with av.open(str(tmp_path / "v.mp4"), "w") as container:
        stream = container.add_stream("aac", rate=44100)
        sound = av.AudioFrame.from_ndarray(np.zeros((1, 1024), np.float32), format="fltp", layout="mono")
        sound.sample_rate = 44100
        container.mux([*stream.encode(sound), *stream.encode(None)])
    with pytest.raises(InputError, match=r"cannot be read as a video \(it has no picture\)"):
        open_clip(tmp_path / "v.mp4")
