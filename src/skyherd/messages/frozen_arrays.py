"""Arrays of a frozen dataclass: validated at construction, copied, and made read-only.

`dataclass(frozen=True)` alone only forbids assignment to a field; the values of its arrays could still be
modified. Messages call `freeze` for each of their arrays in `__post_init__`.
"""

import numpy as np

from skyherd.errors import MessageError
from skyherd.messages.checks import shown

INTEGERS, FLOATS = np.dtype(np.int64), np.dtype(np.float64)
"""Types of frozen arrays."""


def freeze(owner: object, name: str, shape: tuple[int | None, ...], *, integer: bool = False) -> np.ndarray:
    """Replace the field `name` of `owner` by a validated, read-only copy, and return the copy.

    Args:
        owner: the frozen dataclass under construction.
        name: name of the field.
        shape: required shape of the array; None is any length. An empty array of another shape is reshaped to
            it, so that `[]` is valid for no robots.
        integer: whether the copy is of 64-bit integers instead of 64-bit floats.

    Raises:
        MessageError: the shape is wrong, a float is not finite, or a value is not an integer.
    """
    array = _array(owner, name, integer=integer)
    if array.shape != shape and array.size == 0 and 0 in shape:
        array = array.reshape([length or 0 for length in shape])
    if array.shape != shape and not _fits(array.shape, shape):
        raise MessageError(f"{type(owner).__name__}.{name}", f"shape {array.shape}", f"shape {shape}")
    if not integer and not np.logical_and.reduce(np.isfinite(array), axis=None):
        raise MessageError(f"{type(owner).__name__}.{name}", shown(array.tolist()), "finite numbers")
    array.setflags(write=False)
    object.__setattr__(owner, name, array)
    return array


def _array(owner: object, name: str, *, integer: bool) -> np.ndarray:
    """Return a copy of a field as an array of 64-bit integers or floats; whole floats count as integers."""
    given, dtype = getattr(owner, name), INTEGERS if integer else FLOATS
    if type(given) is np.ndarray and given.dtype == dtype:
        return given.copy()
    try:
        given = np.asarray(given)
        if integer and given.dtype.kind not in "iu" and not (given == np.floor(given)).all():
            raise ValueError
        return np.array(given, dtype=dtype)
    except (TypeError, ValueError, OverflowError):
        kind = "whole numbers" if integer else "numbers"
        raise MessageError(f"{type(owner).__name__}.{name}", shown(given), kind) from None


def _fits(actual: tuple[int, ...], expected: tuple[int | None, ...]) -> bool:
    """Return whether a shape is the expected one, in which None is any length."""
    return len(actual) == len(expected) and all(
        want is None or want == have for want, have in zip(expected, actual, strict=True)
    )


def freeze_ids(owner: object, name: str, *, repeats: bool = False) -> int:
    """Freeze a field of ids, as `freeze` does, and return their number.

    Raises:
        MessageError: an id is negative, the field is not a list of integers, or an id occurs twice and
            `repeats` does not allow it.
    """
    ids = freeze(owner, name, (np.size(getattr(owner, name)),), integer=True).tolist()
    if not repeats and len(set(ids)) != len(ids):
        raise MessageError(f"{type(owner).__name__}.{name}", f"repeated id in {shown(ids)}", "each id once")
    if min(ids, default=0) < 0:
        raise MessageError(f"{type(owner).__name__}.{name}", f"negative id in {shown(ids)}", "ids from 0 up")
    return len(ids)


def freeze_image_size(owner: object) -> None:
    """Freeze the field `image_size_px`, (2,) width and height, as `freeze` does.

    Raises:
        MessageError: a number is below 1, or `freeze` rejects the field.
    """
    size_px = freeze(owner, "image_size_px", (2,))
    if not (size_px >= 1).all():
        raise MessageError(f"{type(owner).__name__}.image_size_px", shown(size_px.tolist()), "1 or more")
