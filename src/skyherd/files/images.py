"""Reading of any picture file as a grey image of 8 bits.

Pillow reads it. Transparency lies over white, and the EXIF orientation is applied. With more than 8 bits, the
levels are those of the fewest of 8, 10, 12, 14 and 16 bits that hold the brightest pixel. Cameras of 10 or 12
bits store these unscaled in 16.
"""

import io
import struct
import warnings
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt
from PIL import Image, UnidentifiedImageError

from skyherd.errors import InputError, InputWarning
from skyherd.files.reading import read_bytes

Grey = npt.NDArray[np.uint8]
"""Grey levels of 8 bits, (height, width)."""

MAX_PIXELS = 400_000_000
"""Maximum size of a picture, pixels. *Chosen*: beyond any camera; a small damaged file may claim any size,
and would fill the memory."""

PLAUSIBLE_PIXELS = 50_000_000
"""Size that a file of any length may claim, pixels. *Chosen*: decoded in less than a second."""

PIXELS_A_BYTE = 2000
"""Maximum pixels per byte of a file that claims more than `PLAUSIBLE_PIXELS`. *Chosen*: twice the ratio of a
PNG of one grey level; photographs have about one."""

MAX_BYTES = 2**30
"""Maximum size of a picture file, bytes. *Chosen*: beyond any camera's; it must fit into memory."""

FORMATS = "a PNG, JPEG, TIFF, BMP, WebP or GIF picture"
"""Readable picture formats, as error messages name them."""

DECODERS = ("PNG", "JPEG", "TIFF", "BMP", "WEBP", "GIF", "PPM")
"""Pillow decoders that a file may reach, whatever its name. *Chosen*: the formats of cameras. Pillow has some
forty others, of which one, for EPS, starts another program."""

BIT_DEPTHS = (8, 10, 12, 14, 16)
"""Bits per pixel of cameras. *Chosen*: see the module."""

LUMA = (0.299, 0.587, 0.114)
"""Weights of red, green and blue in grey. *Defined* by ITU-R BT.601, and used by Pillow."""

ORIENTATION = 0x0112
"""EXIF tag number of the camera orientation. *Defined* by EXIF."""

_BROKEN = (
    OSError,
    SyntaxError,
    ValueError,
    EOFError,
    TypeError,
    LookupError,
    ArithmeticError,
    AttributeError,
    NotImplementedError,
    struct.error,
    zlib.error,
    cv2.error,
)
"""Exceptions of Pillow and OpenCV on damaged files."""

SUFFIXES = frozenset(
    {".png", ".jpg", ".jpeg", ".jpe", ".tif", ".tiff", ".bmp", ".webp", ".gif", ".pgm", ".ppm"}
)
"""Suffixes of picture files, used to search a folder."""


def read_grey(path: Path, *, max_pixels: int | None = None) -> Grey:
    """Read a picture file as grey levels (height, width), upright; the first of several pages.

    Warns with `InputWarning` if there are several pages.

    Args:
        path: the file.
        max_pixels: maximum accepted size, pixels; `MAX_PIXELS` if None.

    Raises:
        InputError: the file is missing, incomplete, too large, in CIE Lab, or not a picture.
    """
    return grey_of_bytes(_read_bytes(path), str(path), max_pixels=max_pixels)


def grey_of_bytes(data: bytes, where: str, *, max_pixels: int | None = None) -> Grey:
    """Decode the content of a picture file; see `read_grey`.

    Args:
        data: the content.
        where: its name in errors and warnings.
        max_pixels: maximum accepted size, pixels; `MAX_PIXELS` if None.

    Raises:
        InputError: it is incomplete, too large, in CIE Lab, or not a picture.
    """
    most = MAX_PIXELS if max_pixels is None else max_pixels
    with _quiet_pillow():
        try:
            with Image.open(io.BytesIO(data), formats=DECODERS) as picture:
                pixels = picture.width * picture.height
                if pixels > most:
                    what = f"{pixels / 1e6:.0f} megapixels"
                    raise _refuse(where, what, f"at most {most / 1e6:.0f} can be read")
                if pixels > max(PLAUSIBLE_PIXELS, PIXELS_A_BYTE * len(data)):
                    what = f"damaged: {pixels / 1e6:.0f} megapixels in {len(data)} bytes"
                    raise _refuse(where, what, f"give {FORMATS} that is whole")
                if picture.mode == "LAB":
                    raise _refuse(where, "colour space LAB is not read", "save it as grey or RGB")
                deep = _is_deep(picture)
                picture.load()
                grey = _grey_of_deep(data) if deep else _grey(picture)
                upright = np.ascontiguousarray(_turn(grey, _orientation(picture)))
                pages = _count_pages(picture)
        except InputError:
            raise
        except UnidentifiedImageError:
            raise _refuse(where, "not a picture", f"give {FORMATS}") from None
        except _BROKEN as error:
            why = " ".join(str(error).split()) or type(error).__name__
            raise _refuse(where, f"damaged or cut short ({why})", f"give {FORMATS} that is whole") from None
    if pages > 1:
        warnings.warn(InputWarning(f"{where}: {pages} pages; the first is read"), stacklevel=2)
    return upright


def decode_jpeg(data: bytes, size_px: tuple[int, int]) -> Grey:
    """Decode a JPEG picture of known size to grey levels (height, width), with no other decoder.

    Args:
        data: the file's content.
        size_px: required width and height; they are compared before decoding.

    Raises:
        ValueError: it is not a JPEG picture, has another size, or is damaged.
    """
    with _quiet_pillow():
        try:
            with Image.open(io.BytesIO(data), formats=("JPEG",)) as picture:
                if picture.size != tuple(size_px):
                    raise ValueError(f"image of {picture.width}x{picture.height} px")
                return np.asarray(picture.convert("L"), dtype=np.uint8)
        except _BROKEN as error:
            raise ValueError(f"image: {' '.join(str(error).split())}") from None


def _refuse(where: str, what: str, allowed: str) -> InputError:
    return InputError(where, what, allowed)


def _read_bytes(path: Path) -> bytes:
    data = read_bytes(path, f"give {FORMATS}", MAX_BYTES)
    if not data:
        raise _refuse(str(path), "the file is empty", f"give {FORMATS}")
    return data


@contextmanager
def _quiet_pillow() -> Iterator[None]:
    """Disable Pillow's warnings and its size limit, which large photographs exceed."""
    limit = Image.MAX_IMAGE_PIXELS
    Image.MAX_IMAGE_PIXELS = None
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    finally:
        Image.MAX_IMAGE_PIXELS = limit


def _grey(picture: Image.Image) -> Grey:
    if picture.mode[0] in "IF":
        return grey_of_levels(np.asarray(picture))
    if picture.mode in {"RGBA", "LA", "La", "RGBa", "PA"} or "transparency" in picture.info:
        opaque = Image.new("RGBA", picture.size, "white")
        opaque.alpha_composite(picture.convert("RGBA"))
        picture = opaque.convert("RGB")
    return np.asarray(picture.convert("L"), dtype=np.uint8)


def _is_deep(picture: Image.Image) -> bool:
    """Return whether a file, not yet loaded, has 16 bits per colour, of which Pillow keeps 8."""
    return picture.mode[0] not in "IF" and any(";16" in str(tile[3]) for tile in getattr(picture, "tile", ()))


def _grey_of_deep(data: bytes) -> Grey:
    """Read a file of 16 bits per colour, BGR or BGRA, as grey by OpenCV."""
    decoded = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    if decoded is None:
        raise OSError("16-bit colours cannot be read")
    levels = np.atleast_3d(decoded).astype(np.float32)
    colors = levels[..., :3]
    grey = colors @ np.array(LUMA[::-1], np.float32) if colors.shape[2] == 3 else colors[..., 0]
    grey /= _top_level(float(colors.max()))
    cover = levels[..., 3] / 65535 if levels.shape[2] == 4 else 1.0
    return _scaled(np.asarray(grey * cover + 1 - cover, dtype=np.float32))


def grey_of_levels(levels: npt.NDArray[np.generic]) -> Grey:
    """Convert integers of up to 16 bits and more, or real numbers with white at 1, to grey."""
    values = np.nan_to_num(levels.astype(np.float32))
    top = float(values.max(initial=0.0))
    if levels.dtype.kind == "f" and top <= 1:
        return _scaled(values)
    return _scaled(values / _top_level(top))


def _top_level(brightest: float) -> float:
    """Return the white of the fewest bits that hold the brightest level; that level beyond 16 bits."""
    return next((2.0**bits - 1 for bits in BIT_DEPTHS if brightest < 2**bits), brightest)


def _scaled(share: npt.NDArray[np.float32]) -> Grey:
    return np.asarray(np.rint(255 * share.clip(0, 1)), dtype=np.uint8)


def _count_pages(picture: Image.Image) -> int:
    """Count the pages of a TIFF or frames of an animation; 1 if those after the first are unreadable."""
    try:
        return int(getattr(picture, "n_frames", 1))
    except _BROKEN:
        return 1


def _orientation(picture: Image.Image) -> int:
    try:
        return int(picture.getexif().get(ORIENTATION, 1))
    except _BROKEN:
        return 1


def _turn(image: Grey, orientation: int) -> Grey:
    """Return the picture upright, given its EXIF orientation (1 to 8)."""
    if orientation in (5, 6, 7, 8):
        image = image.T
    if orientation in (2, 3, 6, 7):
        image = image[:, ::-1]
    if orientation in (3, 4, 7, 8):
        image = image[::-1]
    return image
