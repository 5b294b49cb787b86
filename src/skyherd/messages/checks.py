"""Validation of the numbers that the library's constructors receive.

A meaningless number (NaN, a negative gain) would silently make every command meaningless. Scenario files have
further bounds (`datasets/configuration`); these checks apply to every user of the library.
"""

import math
from collections.abc import Iterable

import numpy as np
import numpy.typing as npt

from skyherd.errors import InputError, MessageError
from skyherd.geometry import IntArray
from skyherd.text import shorten

MAX_SHOWN = 60
"""Maximum number of characters of a value in an error. Chosen: a number or a short list."""


def shown(value: object) -> str:
    """Return a value as an error shows it: one line, shortened."""
    try:
        text = " ".join(repr(value).split())
    except ValueError:
        return "an integer of very many digits"
    return text if len(text) <= MAX_SHOWN else f"{text[:MAX_SHOWN]}…"


def check_numbers(
    owner: object,
    *,
    positive: Iterable[str] = (),
    not_negative: Iterable[str] = (),
    finite: Iterable[str] = (),
    endless: Iterable[str] = (),
) -> None:
    """Check the numeric fields of an object.

    Args:
        owner: the object under construction.
        positive: names of fields above 0.
        not_negative: names of fields of 0 or more.
        finite: names of fields of either sign.
        endless: fields among these that may be infinite, for a missing limit.

    Raises:
        InputError: a field is not a number, not finite, or of the wrong sign.
    """
    for names, least, allowed in (
        (positive, math.ulp(0.0), "a number above 0"),
        (not_negative, 0.0, "a number of 0 or more"),
        (finite, -math.inf, "a finite number"),
    ):
        for name in names:
            value = getattr(owner, name)
            if not _is_number(value) or not value >= least or (math.isinf(value) and name not in endless):
                raise InputError(f"{type(owner).__name__}.{name}", shown(value), allowed)


def _is_number(value: object) -> bool:
    """Return whether a value is one real number that fits into a float."""
    try:
        return isinstance(value, (int, float, np.integer, np.floating)) and not math.isnan(value)
    except OverflowError:
        return False


def check_flags(where: str, **flags: object) -> None:
    """Check that arguments are booleans, since the truth value of any other object may be unintended.

    Args:
        where: name of the call for an error.
        **flags: values by name.

    Raises:
        InputError: one is neither True nor False.
    """
    for name, value in flags.items():
        if not isinstance(value, bool | np.bool_):
            raise InputError(f"{where}: {name}", shown(value), "True or False")


def check_texts(where: str, values: object) -> list[str]:
    """Check a list of strings and return it.

    Args:
        where: name of the argument for an error.
        values: value to check; a string instead of a list would be split into its letters.

    Raises:
        InputError: it is not a list, or an element is not a string or cannot be written in UTF-8.
    """
    if isinstance(values, str) or not isinstance(values, Iterable):
        raise InputError(where, shown(values), "a list of texts")
    texts = list(values)
    for text in texts:
        check_kind(where, text, str, "a text")
        try:
            text.encode("utf-8")
        except UnicodeEncodeError:  # of bytes on the command line that are not UTF-8
            raise InputError(f"{where}: {shorten(text, MAX_SHOWN)}", "not UTF-8", "text in UTF-8") from None
    return texts


def check_kind(where: str, value: object, kinds: type | tuple[type, ...], allowed: str) -> None:
    """Check that an argument is of the intended type, such as a mission or a path.

    Args:
        where: name of the argument for an error.
        value: value to check.
        kinds: allowed types.
        allowed: the same in words.

    Raises:
        InputError: it is of another type.
    """
    if not isinstance(value, kinds):
        raise InputError(where, shown(value), allowed)


def check_vectors(where: str, **arrays: object) -> None:
    """Check arguments that are arrays of one dimension.

    Args:
        where: what they are given to.
        **arrays: by name.

    Raises:
        InputError: one is no such array.
    """
    for name, value in arrays.items():
        if not isinstance(value, np.ndarray) or value.ndim != 1:
            raise InputError(f"{where}: {name}", shown(value), "an array of one dimension")


def check_count(where: str, value: object, *, most: int, least: int = 0) -> None:
    """Check a number of things.

    Args:
        where: name of the argument for an error.
        value: value to check.
        most: maximum.
        least: minimum.

    Raises:
        InputError: it is not an integer from `least` to `most`.
    """
    if isinstance(value, bool) or not isinstance(value, int | np.integer) or not least <= value <= most:
        raise InputError(where, shown(value), f"a whole number from {least} to {most}")


def check_ids(ids: npt.ArrayLike, where: str) -> IntArray:
    """Check ids and return them as an array of integers, in the given order.

    Args:
        ids: (N,) ids.
        where: their name in an error.

    Raises:
        InputError: they are not a list of integers from 0 up.
    """
    try:
        given = np.asarray(ids)
        whole = np.array(given, dtype=np.int64)
        right = given.ndim == 1 and bool((whole == given).all() and (whole >= 0).all())
    except (ValueError, TypeError, OverflowError, RuntimeWarning):
        right = False
    if not right:
        raise InputError(where, f"ids {shown(ids)}", "whole numbers from 0 up, in a list")
    return whole


def check_time(owner: object) -> None:
    """Check that the field `time_s` of a message is a finite number.

    Raises:
        MessageError: it is not.
    """
    value = getattr(owner, "time_s", None)
    if not _is_number(value) or math.isinf(value):  # type: ignore[arg-type]
        raise MessageError(f"{type(owner).__name__}.time_s", shown(value), "a finite number")
