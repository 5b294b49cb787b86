"""How kernels, functions that Numba compiles, are compiled, and the types of arrays that they are given.

To compile one takes Numba seconds, when its module is imported for the first time. It keeps the machine code
in `__pycache__`, in the user's cache where that folder cannot be written to, or where `NUMBA_CACHE_DIR` says.
Assignments of whole arrays and reductions of NumPy take longest to compile: loops in their place are quick.
"""

from typing import Any

from numba import njit, uint8
from numba.core import types


def _can_be_kept() -> bool:
    """Whether there is a folder in which compiled code can be kept; without one, each run compiles anew."""
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
