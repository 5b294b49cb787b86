"""How kernels, functions that Numba compiles, are compiled, and the types of arrays that they are given."""

from typing import Any

from numba import njit, uint8
from numba.core import types


def _can_be_kept() -> bool:
    """Return whether compiled code can be cached in a folder; without one, each run compiles it."""
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
"""How functions are compiled. A division by zero gives infinity, and not an error. A multiplication may be
joined with an addition, as the processor has it; nothing else about the numbers is changed, so that those
that are not finite are recognised."""

PARTS: Any = {**FLAGS, "no_cpython_wrapper": True, "no_cfunc_wrapper": True}
"""How functions are compiled that only kernels call: without the ways in from Python and C, which take a
fifth of the time to compile."""

INLINE: Any = {"inline": "always", **FLAGS}
"""How functions are compiled that are called for every pixel: as part of their callers. Calls that hand over
arrays cost as much as the arithmetic. For the same reason they count with unsigned numbers: with others each
index is first asked whether it is negative, and so counts from the end."""


def readonly(kind: Any, ndim: int) -> Any:
    """Type of a contiguous array that is not written to; arrays that could be are taken too."""
    return types.Array(kind, ndim, "C", readonly=True)


IMAGE = readonly(uint8, 2)
"""Type of a grey image of 8 bits."""
