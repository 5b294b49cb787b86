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
def test_lossless_formats_come_back_exactly(tmp_path, suffix) -> None:
    options = {"lossless": True} if suffix == "webp" else {}
    np.testing.assert_array_equal(read(tmp_path / f"a.{suffix}", Image.fromarray(GREY), **options), GREY)


@pytest.mark.parametrize("mode", ["L", "RGB", "CMYK"])
def test_jpeg_comes_back_nearly(tmp_path, mode) -> None:
    """Smooth grey at quality 95: a level or two of quantisation; CMYK's own rounding adds one."""
    grey = read(tmp_path / "a.jpg", Image.fromarray(SMOOTH).convert(mode), quality=95)
    assert np.abs(grey.astype(int) - SMOOTH).max() <= 6


@pytest.mark.parametrize("mode", ["1", "P", "RGB", "RGBA", "LA"])
def test_modes_of_png(tmp_path, mode) -> None:
    want = np.where(GREY > 127, 255, 0).astype(np.uint8) if mode == "1" else GREY
    picture = Image.fromarray(want).convert(mode)
    assert picture.mode == mode
    np.testing.assert_array_equal(read(tmp_path / "a.png", picture), want)


def test_colour_has_the_luma_of_bt601(tmp_path) -> None:
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
def test_sixteen_bits_hold_what_the_camera_gave(tmp_path, bits, suffix) -> None:
    """Levels of 10 to 16 bits are scaled by their own white; a level of 8 bits is 2^bits / 256 of them."""
    top = 2**bits - 1
    levels = np.rint(GREY / 255.0 * top).astype(np.uint16)
    levels[0, 0] = top
    want = np.rint(255.0 * levels / top)
    grey = read(tmp_path / f"a.{suffix}", Image.fromarray(levels))
    np.testing.assert_allclose(grey, want, atol=0.51)
    cv2.imwrite(str(tmp_path / f"c.{suffix}"), np.dstack([levels] * 3))
    np.testing.assert_allclose(read_grey(tmp_path / f"c.{suffix}"), want, atol=1.0)


def test_sixteen_bit_colour_with_transparency(tmp_path) -> None:
    """Mid grey, opaque, clear and half clear over white; one pixel of white sets the scale."""
    bgra = np.full((1, 4, 4), 65535, np.uint16)
    bgra[0, :3, :3] = 32768
    bgra[0, :3, 3] = [65535, 0, 32768]
    cv2.imwrite(str(tmp_path / "a.png"), bgra)
    np.testing.assert_allclose(read_grey(tmp_path / "a.png"), [[128, 255, 191, 255]], atol=1)


def test_real_numbers(tmp_path) -> None:
    shares = (GREY / 255).astype(np.float32)
    np.testing.assert_allclose(read(tmp_path / "a.tif", Image.fromarray(shares)), GREY, atol=0.51)
    shares[0, 0] = np.nan
    assert read(tmp_path / "b.tif", Image.fromarray(shares))[0, 0] == 0


@pytest.mark.parametrize("orientation", range(1, 9))
def test_exif_orientation_is_obeyed(tmp_path, orientation) -> None:
    """Judged by Pillow's own transposition."""
    exif = Image.Exif()
    exif[0x0112] = orientation
    path = tmp_path / "a.png"
    grey = read(path, Image.fromarray(GREY), exif=exif)
    np.testing.assert_array_equal(grey, np.asarray(ImageOps.exif_transpose(Image.open(path))))
    assert (grey.shape == GREY.shape) == (orientation < 5)


def test_a_file_that_claims_far_more_pixels_than_it_can_hold_is_refused_before_it_is_decoded(
    tmp_path, monkeypatch
) -> None:
    """One grey level all over, which no picture is: it is read whole, and not from a third of the file."""
    path = tmp_path / "a.png"
    Image.new("L", (10_000, 6_000), 90).save(path)
    data = path.read_bytes()
    assert read_grey(path).shape == (6_000, 10_000)
    monkeypatch.setattr(ImageFile.ImageFile, "load", lambda *_: pytest.fail("decoded"))
    path.write_bytes(data[: len(data) // 3])
    with pytest.raises(InputError, match=r"60 megapixels in \d+ bytes"):
        read_grey(path)


def test_fifty_megapixels_are_read_without_a_warning(tmp_path) -> None:
    picture = Image.new("L", (10_000, 9_500), 77)
    picture.save(tmp_path / "a.png", compress_level=1)
    limit = Image.MAX_IMAGE_PIXELS
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        grey = read_grey(tmp_path / "a.png")
    assert grey.shape == (9_500, 10_000) and (grey == 77).all()
    assert limit == Image.MAX_IMAGE_PIXELS


def test_a_picture_that_claims_to_be_huge_is_refused(tmp_path, monkeypatch) -> None:
    monkeypatch.setattr(images, "MAX_PIXELS", 1000)
    Image.fromarray(GREY).save(tmp_path / "a.png")
    with pytest.raises(InputError, match=r"a\.png: 0 megapixels"):
        read_grey(tmp_path / "a.png")


@pytest.mark.parametrize("suffix", ["png", "jpg", "tif", "bmp", "gif", "webp"])
@pytest.mark.parametrize("share", [0.02, 0.3, 0.7, 0.95])
def test_files_cut_short_are_refused_in_one_line(tmp_path, suffix, share) -> None:
    """At any length; nothing but InputError comes out, and no warning (tests treat those as errors)."""
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
def test_of_several_pages_the_first_is_read_and_the_others_are_counted(tmp_path, suffix) -> None:
    path, pages = tmp_path / f"a.{suffix}", [GREY, 255 - GREY, GREY // 2]
    first, *others = map(Image.fromarray, pages)
    options = {"lossless": True} if suffix == "webp" else {}
    first.save(path, save_all=True, append_images=others, **options)
    with pytest.warns(InputWarning, match=rf"a\.{suffix}: 3 pages; the first is read$"):
        np.testing.assert_array_equal(read_grey(path), GREY)


def test_a_picture_in_lab_is_refused_as_what_it_is(tmp_path) -> None:
    Image.fromarray(np.dstack([GREY] * 3)).convert("LAB").save(tmp_path / "a.tif")
    with pytest.raises(InputError, match="colour space LAB is not read; save it as grey or RGB"):
        read_grey(tmp_path / "a.tif")


def test_what_is_no_picture_is_said(tmp_path) -> None:
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


def test_damage_anywhere_is_an_input_error_or_a_picture(tmp_path) -> None:
    """Bytes changed at random: Pillow may still read it, but nothing else gets out."""
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


def test_a_recorded_image_is_a_jpeg_of_the_size_that_it_has_to_have() -> None:
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


def test_a_picture_wider_than_opencv_reads_is_refused(tmp_path) -> None:
    """Of 16 bits a colour, for which Pillow is no use."""
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
