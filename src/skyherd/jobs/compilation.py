"""Options of Numba for kernels, and the types of their array arguments."""

from typing import Any

from numba import njit, uint8
from numba.core import types


def _can_be_kept() -> bool:
    """Return whether Numba can cache compiled code in a folder. Otherwise each process compiles it."""
    try:
        njit(cache=True)(_can_be_kept)
    except RuntimeError:
        return False
    return True


FLAGS: Any = {
    "cache": _can_be_kept(),
    "nogil": True,
    "error_model": "numpy",
    "fastmath": {"contract", "nsz"},
}
"""Options of kernels. A division by zero gives infinity or NaN instead of an error. The compiler may fuse a
multiplication with an addition, and may ignore the sign of zero. Other fast-math options are off, so that
tests for infinity and NaN work."""

PARTS: Any = {**FLAGS, "no_cpython_wrapper": True, "no_cfunc_wrapper": True}
"""Options of functions that only kernels call. They have no entry points for Python and C, which take a fifth
of the compile time."""

INLINE: Any = {"inline": "always", **FLAGS}
"""Options of functions that run for every pixel. They are inlined into their callers, since a call with array
arguments costs as much as the arithmetic. Their indices are unsigned, also for speed: Numba tests each signed
index for negative values, which count from the end."""


def readonly(kind: Any, ndim: int) -> Any:
    """Return the type of a contiguous array that a kernel only reads. It accepts writable arrays too."""
    return types.Array(kind, ndim, "C", readonly=True)


IMAGE = readonly(uint8, 2)
"""Type of an 8-bit grey image."""
