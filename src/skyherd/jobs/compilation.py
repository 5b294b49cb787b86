"""Compiler settings of Numba kernels, and types of their array arguments."""

from typing import Any

from numba import njit, uint8
from numba.core import types


def _can_be_kept() -> bool:
    """Return whether compiled code can be cached in a folder. Without a cache each run compiles it."""
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
"""Settings of all functions. Division by zero gives infinity instead of an error. Fused multiply-add is
allowed, and the sign of zero is ignored. Values that are not finite are still recognised."""

PARTS: Any = {**FLAGS, "no_cpython_wrapper": True, "no_cfunc_wrapper": True}
"""Settings of functions that only kernels call: without wrappers for Python and C, which take a fifth of the
compile time."""

INLINE: Any = {"inline": "always", **FLAGS}
"""Settings of functions that are called for each pixel: inlined, since a call with array arguments costs as
much as the arithmetic. They use unsigned indices, which need no check for negative values."""


def readonly(kind: Any, ndim: int) -> Any:
    """Return the type of a contiguous read-only array; it also accepts writable arrays."""
    return types.Array(kind, ndim, "C", readonly=True)


IMAGE = readonly(uint8, 2)
"""Type of a grey image of 8 bits."""
