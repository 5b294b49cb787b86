"""Validated file input: regular files of limited size, explicit decoders, no waiting."""

import io
import json
import os
import threading

import cv2
import numpy as np
import pytest
from PIL import EpsImagePlugin, Image

from skyherd.datasets.configuration.template_image import read_template_image
from skyherd.errors import InputError
from skyherd.files import images, reading, video_reader
from skyherd.files.images import read_grey
from skyherd.files.reading import read_bytes, read_json, read_text
from skyherd.files.video_reader import open_clip, read_clip

EPS = b"""%!PS-Adobe-3.0 EPSF-3.0
%%BoundingBox: 0 0 100 100
%%EndComments
newpath 0 0 moveto 100 100 lineto stroke
showpage
%%EOF
"""


@pytest.fixture
def pipe(tmp_path):
    """Return a FIFO without a writer: opening it as a file blocks for ever."""
    os.mkfifo(tmp_path / "pipe")
    return tmp_path / "pipe"


def test_pipe_is_rejected_without_waiting(pipe):
    def look() -> None:
        for read in (read_grey, open_clip, read_json_of):
            with pytest.raises(InputError, match="is a pipe"):
                read(pipe)
        done.set()

    done = threading.Event()
    threading.Thread(target=look, daemon=True).start()
    assert done.wait(60)


def read_json_of(path):
    return read_json(path, "something else")


@pytest.mark.parametrize(
    ("path", "words"),
    [
        ("/dev/zero", "is a device"),
        (".", "is a folder"),
        ("loop", "Too many levels of symbolic links"),
        ("none", "no such file"),
        ("a\0b", "no file can have this name"),
        ("n" * 300, "File name too long"),
        ("file/below", "Not a directory"),
    ],
)
def test_non_regular_file_is_rejected(tmp_path, path, words):
    (tmp_path / "loop").symlink_to("loop")
    (tmp_path / "file").write_text("x")
    with pytest.raises(InputError, match=words):
        read_bytes(tmp_path / path, "a file", 10)


def test_too_large_file_is_rejected_with_limit(tmp_path):
    path = tmp_path / "big"
    path.write_bytes(bytes(2 * reading.MIB))
    with pytest.raises(InputError, match=r"has 2 MiB or more; at most 1 MiB are read"):
        read_bytes(path, "a file", reading.MIB)
    assert len(read_bytes(path, "a file", 2 * reading.MIB)) == 2 * reading.MIB
    with pytest.raises(InputError, match="MiB or more"):  # says that it is empty, and is not
        read_bytes(reading.Path("/proc/self/maps"), "a file", 100)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("[" * 100_000, "nested more than 64 deep"),
        ("[" * 66 + "]" * 66, "nested more than 64 deep"),
        ('{"a": ' * 66 + "1" + "}" * 66, "nested more than 64 deep"),
        ("9" * 5000, "damaged"),
        ("{", "damaged"),
        ("\x80", "UTF-8"),
    ],
)
def test_invalid_json_is_input_error(tmp_path, text, words):
    path = tmp_path / "a.json"
    path.write_bytes(text.encode("latin-1"))
    with pytest.raises(InputError, match=words):
        read_json(path, "a good one")


def test_byte_order_mark_is_no_part_of_a_text(tmp_path):
    path = tmp_path / "a.json"
    path.write_text('"\ufeffé"', "utf-8-sig")
    assert read_text(path, "a good one", reading.MIB) == '"\ufeffé"'
    assert read_json(path, "a good one") == "\ufeffé"


def test_json_of_64_levels_is_read(tmp_path):
    path = tmp_path / "a.json"
    path.write_text("[" * 64 + "1" + "]" * 64)
    value = read_json(path, "a good one")
    for _ in range(64):
        (value,) = value
    assert value == 1


def test_picture_starts_no_other_program(tmp_path, monkeypatch):
    """An EPS file named .png. Negative control: Pillow alone would start Ghostscript."""
    started = []

    def start(*arguments) -> None:
        started.append(arguments)
        raise OSError("no Ghostscript here")

    monkeypatch.setattr(EpsImagePlugin, "Ghostscript", start)
    path = tmp_path / "a.png"
    path.write_bytes(EPS)
    with pytest.raises(OSError, match="no Ghostscript"), Image.open(io.BytesIO(EPS)) as picture:
        picture.load()
    assert len(started) == 1
    for read in (read_grey, lambda path: read_template_image(path, "4X4_50")):
        with pytest.raises(InputError, match="not a picture"):
            read(path)
    assert len(started) == 1


@pytest.mark.parametrize("kind", ["ICO", "TGA", "SGI", "PCX", "ICNS", "JPEG2000", "MSP"])
def test_non_camera_formats_are_rejected(tmp_path, kind):
    mode = "1" if kind == "MSP" else "RGB"
    Image.new(mode, (16, 16)).save(tmp_path / "a.png", format=kind)
    with pytest.raises(InputError, match="not a picture"):
        read_grey(tmp_path / "a.png")


def test_every_picture_suffix_has_a_decoder():
    kinds = Image.registered_extensions()
    assert {kinds[suffix] for suffix in images.SUFFIXES} <= set(images.DECODERS)


def test_playlist_named_as_video_opens_no_other_file(tmp_path, monkeypatch):
    """FFmpeg would read the list, and then the files and addresses in it."""
    writer = cv2.VideoWriter(str(tmp_path / "a.avi"), cv2.VideoWriter_fourcc(*"MJPG"), 5, (64, 48))
    for _ in range(3):
        writer.write(np.zeros((48, 64, 3), np.uint8))
    writer.release()
    assert len(list(read_clip(open_clip(tmp_path / "a.avi")))) == 3
    (tmp_path / "list.mp4").write_text("ffconcat version 1.0\nfile a.avi\n")
    (tmp_path / "hls.m3u8.ts").write_text("#EXTM3U\n#EXTINF:1,\na.avi\n#EXT-X-ENDLIST\n")
    for name in ("list.mp4", "hls.m3u8.ts"):
        with pytest.raises(InputError, match="cannot be read as a video"):
            open_clip(tmp_path / name)


def test_special_ffmpeg_names_are_plain_names(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for name in ("concat:a.mp4", os.fsdecode(b"\xff.mp4")):
        path = reading.Path(name)
        path.write_bytes(b"no video")
        with pytest.raises(InputError, match="cannot be read as a video"):
            open_clip(path)


def test_template_image_has_smaller_size_limit(tmp_path):
    """20000x20000 px: a black PNG of any size is a small file."""
    Image.new("1", (20000, 20000)).save(tmp_path / "a.png")
    with pytest.raises(InputError, match="400 megapixels; at most 50 can be read"):
        read_template_image(tmp_path / "a.png", "4X4_50")


def test_every_video_suffix_has_a_container():
    assert {"mov", "matroska", "avi", "mpeg", "mpegts", "asf"} <= set(video_reader.CONTAINERS)
    assert json.dumps(video_reader.OPTIONS)
