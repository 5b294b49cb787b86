"""Plugins of the user, given as `module:factory`, and optional libraries, which extras install."""

import logging
import os
import sys
from collections.abc import Callable
from importlib import import_module
from typing import Any, cast

from skyherd.errors import InputError

_log = logging.getLogger(__name__)


def import_factory(name: str, where: str, allowed: str) -> Callable[..., Any]:
    """Import the callable given as `module:factory`, also from the working directory.

    Args:
        name: `module:factory`.
        where: its name in an error, such as `detector own:Square`.
        allowed: description of an allowed factory.

    Raises:
        InputError: the name lacks a part, the module cannot be imported, has no such attribute, or the
            attribute is not callable.
    """
    module_name, _, factory_name = name.partition(":")
    if not module_name or not factory_name:
        raise InputError(where, "lacks a module or a factory", "write it as module:factory")
    if os.getcwd() not in sys.path:
        sys.path.insert(0, os.getcwd())
    try:
        module = import_module(module_name)
    except Exception as error:
        raise InputError(
            where, f"{type(error).__name__}: {error}", "a module that can be imported from here"
        ) from error
    if not hasattr(module, factory_name):
        raise InputError(where, f"has no attribute {factory_name!r}", allowed)
    factory = getattr(module, factory_name)
    if not callable(factory):
        raise InputError(where, f"{factory_name!r} is not callable", allowed)
    _log.info("%s is %s of %s", where, factory_name, getattr(module, "__file__", None) or module_name)
    return cast(Callable[..., Any], factory)


def import_extra(module: str, package: str, where: str, extra: str) -> Any:
    """Import and return a module of an optional library.

    Args:
        module: name of the module.
        package: name of its package in the registry.
        where: location in the error message, such as the option that needs the module.
        extra: the extra of skyherd that installs it.

    Raises:
        InputError: the package is not installed.
    """
    try:
        return import_module(module)
    except ImportError:
        raise InputError(where, f"{package} is not installed", f"pip install 'skyherd[{extra}]'") from None
