"""Optional libraries of `skyherd[live]`."""

from importlib import import_module
from typing import Any

from skyherd.errors import InputError


def import_extra(module: str, package: str, where: str) -> Any:
    """Import and return a module of the extra `live`.

    Args:
        module: name of the module.
        package: name of its package in the registry.
        where: location in the error message, such as the driver that needs the module.

    Raises:
        InputError: the package is not installed.
    """
    try:
        return import_module(module)
    except ImportError:
        raise InputError(where, f"{package} is not installed", "pip install 'skyherd[live]'") from None
