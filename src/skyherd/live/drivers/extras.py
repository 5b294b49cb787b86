"""Libraries that only `skyherd[live]` installs."""

from importlib import import_module
from typing import Any

from skyherd.errors import InputError


def import_extra(module: str, package: str, where: str) -> Any:
    """A module of the extra `live`.

    Args:
        module: its name.
        package: what it is called in the registry.
        where: what a complaint calls whoever needs it.

    Raises:
        InputError: it is not installed.
    """
    try:
        return import_module(module)
    except ImportError:
        raise InputError(where, f"{package} is not installed", "pip install 'skyherd[live]'") from None
