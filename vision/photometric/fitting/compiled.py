"""Loading of compiled kernels when they are first needed.

To import a kernel takes up to a second, and up to twenty where Numba has to compile it first. Commands that
look at no image must not wait for that, so that the modules that call kernels ask for them here in place of
importing them.
"""

from functools import cache
from importlib import import_module
from types import ModuleType


@cache
def kernel(module: str) -> ModuleType:
    """Return a module of the package `kernels` by its name, which is imported at the first call.

    Raises:
        ModuleNotFoundError: there is no module of this name.
    """
    return import_module(f"skyherd.vision.photometric.fitting.kernels.{module}")
