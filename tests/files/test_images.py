"""Every picture format gives the same grey image; other files give one error line."""

import contextlib
import io
import struct
import warnings
import zlib
from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import Image, ImageFile, ImageOps

from skyherd.errors import InputError, InputWarning
from skyherd.files import images
from skyherd.files.images import decode_jpeg, read_grey

RNG = np.random.default_rng(5)
GREY = RNG.integers(0, 256, (30, 44)).astype(np.uint8)
"""Noise, which reveals any error in position or level."""

SMOOTH = cv2.GaussianBlur(GREY, (0, 0), 4)


def read(path: Path, picture: Image.Image, **options) -> np.ndarray:
    picture.save(path, **options)
    grey = read_grey(path)
    assert grey.dtype == np.uint8 and grey.ndim == 2 and grey.flags.c_contiguous
    return grey


@pytest.mark.smoke
@pytest.mark.parametrize("suffix", ["png", "tif", "bmp", "webp", "gif", "pgm"])
def test_lossless_formats_are_read_exactly(tmp_path, suffix) -> None:
    options = {"lossless": True} if suffix == "webp" else {}
    np.testing.assert_array_equal(read(tmp_path / f"a.{suffix}", Image.fromarray(GREY), **options), GREY)


@pytest.mark.parametrize("mode", ["L", "RGB", "CMYK"])
def test_jpeg_is_read_within_quantisation(tmp_path, mode) -> None:
    """Smooth grey at quality 95: a level or two of quantisation; CMYK's own rounding adds one."""
    grey = read(tmp_path / "a.jpg", Image.fromarray(SMOOTH).convert(mode), quality=95)
    assert np.abs(grey.astype(int) - SMOOTH).max() <= 6


@pytest.mark.parametrize("mode", ["1", "P", "RGB", "RGBA", "LA"])
def test_png_modes_are_read(tmp_path, mode) -> None:
    want = np.where(GREY > 127, 255, 0).astype(np.uint8) if mode == "1" else GREY
    picture = Image.fromarray(want).convert(mode)
    assert picture.mode == mode
    np.testing.assert_array_equal(read(tmp_path / "a.png", picture), want)


def test_colour_becomes_bt601_luma(tmp_path) -> None:
    colors = RNG.integers(0, 256, (20, 20, 3)).astype(np.uint8)
    want = colors @ [0.299, 0.587, 0.114]
    np.testing.assert_allclose(read(tmp_path / "a.png", Image.fromarray(colors)), want, atol=0.51)


def test_transparency_lies_over_white(tmp_path) -> None:
    rgba = np.zeros((2, 2, 4), np.uint8)
    rgba[..., 3] = [[0, 255], [128, 64]]
    np.testing.assert_allclose(
        read(tmp_path / "a.png", Image.fromarray(rgba)), [[255, 0], [127, 191]], atol=0.51
    )
    palette = Image.new("P", (2, 1))
    palette.putpalette([0, 0, 0, 90, 90, 90])
    palette.putpixel((1, 0), 1)
    np.testing.assert_array_equal(read(tmp_path / "p.png", palette, transparency=0), [[255, 90]])


@pytest.mark.parametrize("bits", [8, 10, 12, 14, 16])
@pytest.mark.parametrize("suffix", ["png", "tif"])
def test_sixteen_bit_levels_scale_by_their_white(tmp_path, bits, suffix) -> None:
    """Levels of 10 to 16 bits are scaled by their white; 8-bit levels are 2^bits / 256 of them."""
    top = 2**bits - 1
    levels = np.rint(GREY / 255.0 * top).astype(np.uint16)
    levels[0, 0] = top
    want = np.rint(255.0 * levels / top)
    grey = read(tmp_path / f"a.{suffix}", Image.fromarray(levels))
    np.testing.assert_allclose(grey, want, atol=0.51)
    cv2.imwrite(str(tmp_path / f"c.{suffix}"), np.dstack([levels] * 3))
    np.testing.assert_allclose(read_grey(tmp_path / f"c.{suffix}"), want, atol=1.0)


def test_sixteen_bit_colour_lies_over_white(tmp_path) -> None:
    """Mid grey, opaque, clear and half clear over white; one white pixel sets the scale."""
    bgra = np.full((1, 4, 4), 65535, np.uint16)
    bgra[0, :3, :3] = 32768
    bgra[0, :3, 3] = [65535, 0, 32768]
    cv2.imwrite(str(tmp_path / "a.png"), bgra)
    np.testing.assert_allclose(read_grey(tmp_path / "a.png"), [[128, 255, 191, 255]], atol=1)


def test_float_levels_are_scaled(tmp_path) -> None:
    shares = (GREY / 255).astype(np.float32)
    np.testing.assert_allclose(read(tmp_path / "a.tif", Image.fromarray(shares)), GREY, atol=0.51)
    shares[0, 0] = np.nan
    assert read(tmp_path / "b.tif", Image.fromarray(shares))[0, 0] == 0


@pytest.mark.parametrize("orientation", range(1, 9))
def test_exif_orientation_is_applied(tmp_path, orientation) -> None:
    """Pillow's own transposition is the reference."""
    exif = Image.Exif()
    exif[0x0112] = orientation
    path = tmp_path / "a.png"
    grey = read(path, Image.fromarray(GREY), exif=exif)
    np.testing.assert_array_equal(grey, np.asarray(ImageOps.exif_transpose(Image.open(path))))
    assert (grey.shape == GREY.shape) == (orientation < 5)


def test_implausible_size_is_rejected_before_decoding(tmp_path, monkeypatch) -> None:
    """Uniform grey, unlike any photograph: read whole, and not from a third of the file."""
    path = tmp_path / "a.png"
    Image.new("L", (10_000, 6_000), 90).save(path)
    data = path.read_bytes()
    assert read_grey(path).shape == (6_000, 10_000)
    monkeypatch.setattr(ImageFile.ImageFile, "load", lambda *_: pytest.fail("decoded"))
    path.write_bytes(data[: len(data) // 3])
    with pytest.raises(InputError, match=r"60 megapixels in \d+ bytes"):
        read_grey(path)


def test_fifty_megapixels_are_read_without_warning(tmp_path) -> None:
    picture = Image.new("L", (10_000, 9_500), 77)
    picture.save(tmp_path / "a.png", compress_level=1)
    limit = Image.MAX_IMAGE_PIXELS
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        grey = read_grey(tmp_path / "a.png")
    assert grey.shape == (9_500, 10_000) and (grey == 77).all()
    assert limit == Image.MAX_IMAGE_PIXELS


def test_huge_claimed_size_is_rejected(tmp_path, monkeypatch) -> None:
    monkeypatch.setattr(images, "MAX_PIXELS", 1000)
    Image.fromarray(GREY).save(tmp_path / "a.png")
    with pytest.raises(InputError, match=r"a\.png: 0 megapixels"):
        read_grey(tmp_path / "a.png")


@pytest.mark.parametrize("suffix", ["png", "jpg", "tif", "bmp", "gif", "webp"])
@pytest.mark.parametrize("share", [0.02, 0.3, 0.7, 0.95])
def test_truncated_files_are_rejected(tmp_path, suffix, share) -> None:
    """At any length, only InputError is raised, without a warning (an error in tests)."""
    file = io.BytesIO()
    Image.fromarray(np.tile(GREY, (4, 4))).save(
        file, format={"jpg": "jpeg", "tif": "tiff"}.get(suffix, suffix)
    )
    path = tmp_path / f"a.{suffix}"
    path.write_bytes(file.getvalue()[: int(share * len(file.getvalue()))])
    with pytest.raises(InputError) as refused:
        read_grey(path)
    assert "\n" not in str(refused.value) and str(path) in str(refused.value)


@pytest.mark.parametrize("suffix", ["tif", "gif", "webp"])
def test_first_of_several_pages_is_read_with_warning(tmp_path, suffix) -> None:
    path, pages = tmp_path / f"a.{suffix}", [GREY, 255 - GREY, GREY // 2]
    first, *others = map(Image.fromarray, pages)
    options = {"lossless": True} if suffix == "webp" else {}
    first.save(path, save_all=True, append_images=others, **options)
    with pytest.warns(InputWarning, match=rf"a\.{suffix}: 3 pages; the first is read$"):
        np.testing.assert_array_equal(read_grey(path), GREY)


def test_lab_picture_is_rejected(tmp_path) -> None:
    Image.fromarray(np.dstack([GREY] * 3)).convert("LAB").save(tmp_path / "a.tif")
    with pytest.raises(InputError, match="colour space LAB is not read; save it as grey or RGB"):
        read_grey(tmp_path / "a.tif")


def test_non_picture_is_rejected(tmp_path) -> None:
    (tmp_path / "empty.png").write_bytes(b"")
    (tmp_path / "text.png").write_text("not a picture")
    for name, words in (
        ("empty.png", "empty"),
        ("text.png", "not a picture"),
        ("none.png", "no such file"),
        (".", "folder"),
    ):
        with pytest.raises(InputError, match=words):
            read_grey(tmp_path / name)


def test_damaged_file_gives_input_error_or_picture(tmp_path) -> None:
    """Random bytes change: Pillow may still read it, but no other error is raised."""
    rng = np.random.default_rng(1)
    for suffix, form in (("png", "png"), ("jpg", "jpeg"), ("tif", "tiff"), ("webp", "webp")):
        file = io.BytesIO()
        Image.fromarray(GREY).save(file, format=form)
        for _ in range(60):
            data = np.frombuffer(file.getvalue(), np.uint8).copy()
            data[rng.integers(0, data.size, 4)] = rng.integers(0, 256, 4)
            path = tmp_path / f"a.{suffix}"
            path.write_bytes(data.tobytes())
            with contextlib.suppress(InputError):
                assert read_grey(path).ndim == 2


def test_decode_jpeg_requires_jpeg_of_given_size() -> None:
    def encoded(kind, size=(44, 30)):
        stream = io.BytesIO()
        Image.fromarray(SMOOTH).resize(size).save(stream, format=kind)
        return stream.getvalue()

    assert np.abs(decode_jpeg(encoded("JPEG"), (44, 30)).astype(int) - SMOOTH).max() <= 6
    for kind, size in (("PNG", (44, 30)), ("EPS", (44, 30)), ("JPEG", (30, 44))):
        with pytest.raises(ValueError, match="image"):
            decode_jpeg(encoded(kind, size), (44, 30))
    for data in (b"", b"x", encoded("JPEG")[:100]):
        with pytest.raises(ValueError, match="image"):
            decode_jpeg(data, (44, 30))


def test_picture_wider_than_opencv_limit_is_rejected(tmp_path) -> None:
    """16 bits per colour, which Pillow cannot read."""
    stream = struct.pack(">II5B", 2**20 + 1, 1, 16, 2, 0, 0, 0)
    rows = zlib.compress(bytes(1 + 6 * (2**20 + 1)))
    chunks = ((b"IHDR", stream), (b"IDAT", rows), (b"IEND", b""))
    parts = [
        struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
        for kind, data in chunks
    ]
    (tmp_path / "a.png").write_bytes(b"\x89PNG\r\n\x1a\n" + b"".join(parts))
    with pytest.raises(InputError, match="damaged"):
        read_grey(tmp_path / "a.png")
