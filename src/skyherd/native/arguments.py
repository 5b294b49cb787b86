"""Checks of the arguments and results of compiled functions."""

from collections.abc import Mapping

import numpy as np
import numpy.typing as npt

from skyherd.errors import InputError

Errors = Mapping[int, tuple[str, str, str]]
"""Negative results of a library: where, the problem, and what is allowed."""


def address(where: str, array: object, dtype: npt.DTypeLike, shape: tuple[int, ...]) -> int:
    """Return the address of the memory of a contiguous array of one type and shape.

    Raises:
        InputError: it is not such an array.
    """
    if not isinstance(array, np.ndarray):
        raise InputError(where, f"a {type(array).__name__}", f"contiguous, {shape}, {np.dtype(dtype)}")
    if array.dtype != dtype or array.shape != shape or not array.flags.c_contiguous:
        allowed = f"contiguous, {shape}, {np.dtype(dtype)}"
        raise InputError(where, f"shape {array.shape}, {array.dtype}", allowed)
    return int(array.ctypes.data)


def check_plane(where: str, plane: object, shape: tuple[int, int] | None) -> None:
    """Check that a value is a contiguous plane of uint8, of one shape if it is given.

    Raises:
        InputError: it is not.
    """
    allowed = f"contiguous, {shape or '(height, width)'}, uint8"
    if not isinstance(plane, np.ndarray):
        raise InputError(where, f"a {type(plane).__name__}", allowed)
    valid = plane.ndim == 2 and plane.dtype == np.uint8 and plane.flags.c_contiguous
    if not valid or (shape is not None and plane.shape != shape):
        raise InputError(where, f"shape {plane.shape}, {plane.dtype}", allowed)


def check(result: int, errors: Errors) -> int:
    """Return a result of a library that is no error.

    Raises:
        InputError: the library rejected an argument.
    """
    if result < 0:
        raise InputError(*errors[result])
    return result
