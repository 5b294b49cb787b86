"""Reads any picture file as a grey image of 8 bits.

Pillow reads it; transparency lies over white, and the camera's orientation mark (EXIF) is obeyed. Of more
than 8 bits, levels are those of the fewest of 8, 10, 12, 14 and 16 bits that hold the brightest pixel:
cameras of 10 or 12 bits store these as they are in 16.
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
"""Pixels of the largest picture that is read. *Chosen*: beyond any camera; a small damaged file may claim any
size, and would fill the memory."""

PLAUSIBLE_PIXELS = 50_000_000
"""Pixels that a file of any size may claim. *Chosen*: decoded in less than a second."""

PIXELS_A_BYTE = 2000
"""Most pixels for each byte of a file that claims more than `PLAUSIBLE_PIXELS`. *Chosen*: twice what PNG
makes of one grey level all over; photographs have about one. A damaged file of a kilobyte may claim any size,
and is then refused before seconds are spent on decoding it."""

MAX_BYTES = 2**30
"""Size of the largest picture file that is read. *Chosen*: beyond any camera's; it has to fit the memory."""

FORMATS = "a PNG, JPEG, TIFF, BMP, WebP or GIF picture"
"""Kinds of pictures that can be read, as complaints name them."""

DECODERS = ("PNG", "JPEG", "TIFF", "BMP", "WEBP", "GIF", "PPM")
"""The decoders of Pillow that a file may reach, whatever its name says. *Chosen*: the formats of cameras.
Pillow has some forty others, of which one, for EPS, starts another program."""

BIT_DEPTHS = (8, 10, 12, 14, 16)
"""Bits a pixel that cameras have. *Chosen*: see the module."""

LUMA = (0.299, 0.587, 0.114)
"""Weights of red, green and blue in grey. *Defined* by ITU-R BT.601, and used by Pillow."""

ORIENTATION = 0x0112
"""Number of the EXIF tag that says how the camera was held. *Defined* by EXIF."""

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
"""What Pillow and OpenCV raise on files that are damaged in one way or another."""

SUFFIXES = frozenset(
    {".png", ".jpg", ".jpeg", ".jpe", ".tif", ".tiff", ".bmp", ".webp", ".gif", ".pgm", ".ppm"}
)
"""How the names of picture files end, by which a folder is searched."""


def read_grey(path: Path, *, max_pixels: int | None = None) -> Grey:
    """Read a picture file as grey levels (height, width), upright; of several pages, the first.

    Warns with `InputWarning` if there are several.

    Args:
        path: the file.
        max_pixels: pixels of the largest picture that is accepted; `MAX_PIXELS` if None.

    Raises:
        InputError: there is no such file, or it is no whole picture, or it is too large, or in CIE Lab.
    """
    data, most = _read_bytes(path), MAX_PIXELS if max_pixels is None else max_pixels
    with _quiet_pillow():
        try:
            with Image.open(io.BytesIO(data), formats=DECODERS) as picture:
                pixels = picture.width * picture.height
                if pixels > most:
                    what = f"{pixels / 1e6:.0f} megapixels"
                    raise _refuse(path, what, f"at most {most / 1e6:.0f} can be read")
                if pixels > max(PLAUSIBLE_PIXELS, PIXELS_A_BYTE * len(data)):
                    what = f"damaged: {pixels / 1e6:.0f} megapixels in {len(data)} bytes"
                    raise _refuse(path, what, f"give {FORMATS} that is whole")
                if picture.mode == "LAB":
                    raise _refuse(path, "colour space LAB is not read", "save it as grey or RGB")
                deep = _is_deep(picture)
                picture.load()
                grey = _grey_of_deep(data) if deep else _grey(picture)
                upright = np.ascontiguousarray(_turn(grey, _orientation(picture)))
                pages = _count_pages(picture)
        except InputError:
            raise
        except UnidentifiedImageError:
            raise _refuse(path, "not a picture", f"give {FORMATS}") from None
        except _BROKEN as error:
            why = " ".join(str(error).split()) or type(error).__name__
            raise _refuse(path, f"damaged or cut short ({why})", f"give {FORMATS} that is whole") from None
    if pages > 1:
        warnings.warn(InputWarning(f"{path}: {pages} pages; the first is read"), stacklevel=2)
    return upright


def decode_jpeg(data: bytes, size_px: tuple[int, int]) -> Grey:
    """Grey levels (height, width) of a JPEG picture of a known size, which no other decoder gets to see.

    Args:
        data: the file's content.
        size_px: width and height that it has to have; they are compared before anything is decoded.

    Raises:
        ValueError: it is no JPEG picture, it has another size, or it is damaged.
    """
    with _quiet_pillow():
        try:
            with Image.open(io.BytesIO(data), formats=("JPEG",)) as picture:
                if picture.size != tuple(size_px):
                    raise ValueError(f"image of {picture.width}x{picture.height} px")
                return np.asarray(picture.convert("L"), dtype=np.uint8)
        except _BROKEN as error:
            raise ValueError(f"image: {' '.join(str(error).split())}") from None


def _refuse(path: Path, what: str, allowed: str) -> InputError:
    return InputError(str(path), what, allowed)


def _read_bytes(path: Path) -> bytes:
    data = read_bytes(path, f"give {FORMATS}", MAX_BYTES)
    if not data:
        raise _refuse(path, "the file is empty", f"give {FORMATS}")
    return data


@contextmanager
def _quiet_pillow() -> Iterator[None]:
    """Pillow without its warnings and its own limit of size, which large photographs exceed."""
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
        return _grey_of_levels(np.asarray(picture))
    if picture.mode in {"RGBA", "LA", "La", "RGBa", "PA"} or "transparency" in picture.info:
        opaque = Image.new("RGBA", picture.size, "white")
        opaque.alpha_composite(picture.convert("RGBA"))
        picture = opaque.convert("RGB")
    return np.asarray(picture.convert("L"), dtype=np.uint8)


def _is_deep(picture: Image.Image) -> bool:
    """Whether the file, not yet loaded, has 16 bits a colour, of which Pillow keeps 8."""
    return picture.mode[0] not in "IF" and any(";16" in str(tile[3]) for tile in getattr(picture, "tile", ()))


def _grey_of_deep(data: bytes) -> Grey:
    """Grey of a file of 16 bits a colour, which OpenCV keeps: BGR or BGRA."""
    decoded = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    if decoded is None:
        raise OSError("its 16-bit colours cannot be read")
    levels = np.atleast_3d(decoded).astype(np.float32)
    colors = levels[..., :3]
    grey = colors @ np.array(LUMA[::-1], np.float32) if colors.shape[2] == 3 else colors[..., 0]
    grey /= _top_level(float(colors.max()))
    cover = levels[..., 3] / 65535 if levels.shape[2] == 4 else 1.0
    return _scaled(np.asarray(grey * cover + 1 - cover, dtype=np.float32))


def _grey_of_levels(levels: npt.NDArray[np.generic]) -> Grey:
    """Grey of whole numbers of up to 16 and more, or of real numbers, where 1 is white if none is above."""
    values = np.nan_to_num(levels.astype(np.float32))
    top = float(values.max(initial=0.0))
    if levels.dtype.kind == "f" and top <= 1:
        return _scaled(values)
    return _scaled(values / _top_level(top))


def _top_level(brightest: float) -> float:
    """White of the fewest bits that hold the brightest level; the brightest itself beyond 16 bits."""
    return next((2.0**bits - 1 for bits in BIT_DEPTHS if brightest < 2**bits), brightest)


def _scaled(share: npt.NDArray[np.float32]) -> Grey:
    return np.asarray(np.rint(255 * share.clip(0, 1)), dtype=np.uint8)


def _count_pages(picture: Image.Image) -> int:
    """Pages of a TIFF or frames of an animation; 1 if those after the first cannot be counted."""
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
    """The picture upright, given EXIF's mark of how the camera was held (1 to 8)."""
    if orientation in (5, 6, 7, 8):
        image = image.T
    if orientation in (2, 3, 6, 7):
        image = image[:, ::-1]
    if orientation in (3, 4, 7, 8):
        image = image[::-1]
    return image
