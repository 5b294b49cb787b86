"""Validated file input: regular files of limited size.

A pipe would block a reader for ever, a device has no end, and a file may exceed the memory. Every reader of
the package therefore opens files here, with the maximum size of its kind of file.
"""

import json
import os
import stat
from collections.abc import Iterable
from pathlib import Path
from typing import Any, BinaryIO

from skyherd.errors import InputError

MIB = 2**20
"""Bytes of a mebibyte, the unit of limits."""

MAX_JSON_BYTES = 64 * MIB
"""Maximum size of a JSON file, bytes. *Chosen*: the largest that the package writes, the COCO file of ten
thousand images, has some 30 MiB."""

MAX_JSON_LEVELS = 64
"""Maximum nesting of lists and objects in a JSON file. *Chosen*: files of the package have fewer than ten
levels, and readers recurse once per level."""

KINDS = (
    (stat.S_ISDIR, "is a folder"),
    (stat.S_ISFIFO, "is a pipe"),
    (stat.S_ISCHR, "is a device"),
    (stat.S_ISBLK, "is a device"),
    (stat.S_ISSOCK, "is a socket"),
)
"""Names of non-regular files in error messages."""


def open_regular(path: Path, allowed: str, max_bytes: int | None = None) -> BinaryIO:
    """Open a regular file for reading; reject a pipe or a device without waiting for it.

    Args:
        path: the file; a symbolic link is followed.
        allowed: what to give instead, as the complaint says it.
        max_bytes: size of the largest file that is accepted; None for any.

    Raises:
        InputError: there is no such file, it cannot be opened, it is not a regular file, or it is too large.
    """
    try:
        _check_kind(path, os.stat(path).st_mode, allowed)
        stream = open(os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0)), "rb")  # noqa: SIM115
    except InputError:
        raise
    except FileNotFoundError:
        raise InputError(str(path), "no such file", allowed) from None
    except OSError as error:
        raise InputError(str(path), f"cannot be read: {error.strerror}", allowed) from None
    except ValueError:
        raise InputError(str(path), "no file can have this name", allowed) from None
    try:
        found = os.fstat(stream.fileno())
        _check_kind(path, found.st_mode, allowed)
        if max_bytes is not None and found.st_size > max_bytes:
            raise _too_large(path, found.st_size, max_bytes)
    except InputError:
        stream.close()
        raise
    return stream


def read_bytes(path: Path, allowed: str, max_bytes: int) -> bytes:
    """Read a regular file of at most `max_bytes`; arguments and errors are those of `open_regular`."""
    with open_regular(path, allowed, max_bytes) as stream:
        try:
            data = stream.read(max_bytes + 1)
        except OSError as error:
            raise InputError(str(path), f"cannot be read: {error.strerror}", allowed) from None
    if len(data) > max_bytes:
        raise _too_large(path, len(data), max_bytes)
    return data


def read_text(path: Path, allowed: str, max_bytes: int) -> str:
    """Read a text file in UTF-8 of at most `max_bytes`; arguments are those of `open_regular`.

    A byte order mark at the start, as editors of Windows write it, is no part of the text.

    Raises:
        InputError: `open_regular` rejects it, or it is not UTF-8 text.
    """
    try:
        return read_bytes(path, allowed, max_bytes).decode("utf-8-sig")
    except UnicodeDecodeError:
        raise InputError(str(path), "not a text file in UTF-8", allowed) from None


def read_json(path: Path, allowed: str, max_bytes: int = MAX_JSON_BYTES) -> Any:
    """Read a JSON file as dictionaries, lists and plain values.

    Raises:
        InputError: `open_regular` rejects it, or it is not valid JSON.
    """
    text = read_text(path, allowed, max_bytes)
    try:
        return parse_json(text)
    except ValueError as error:
        raise InputError(str(path), f"damaged: {error}", allowed) from None


def parse_json(text: str) -> Any:
    """Parse a JSON text as dictionaries, lists and plain values.

    Raises:
        ValueError: it is no JSON, or nested more than `MAX_JSON_LEVELS` deep.
    """
    too_deep = f"nested more than {MAX_JSON_LEVELS} deep"
    try:
        value = json.loads(text)
    except RecursionError:
        raise ValueError(too_deep) from None
    level, depth = [value], 0
    while level := [child for node in level for child in _children(node)]:
        depth += 1
        if depth > MAX_JSON_LEVELS:
            raise ValueError(too_deep)
    return value


def _children(node: Any) -> Iterable[Any]:
    """Return the values within a JSON value."""
    return node.values() if isinstance(node, dict) else node if isinstance(node, list) else ()


def is_regular(path: Path) -> bool:
    """Return whether a regular file, or a link to one, exists at a path; False for an impossible path."""
    try:
        return stat.S_ISREG(os.stat(path).st_mode)
    except (OSError, ValueError):
        return False


def _check_kind(path: Path, mode: int, allowed: str) -> None:
    if not stat.S_ISREG(mode):
        what = next((name for test, name in KINDS if test(mode)), "is not a regular file")
        raise InputError(str(path), what, allowed)


def _too_large(path: Path, found_bytes: int, max_bytes: int) -> InputError:
    return InputError(str(path), f"has {_size(found_bytes)} or more", f"at most {_size(max_bytes)} are read")


def _size(count: int) -> str:
    """Format a number of bytes in the unit in which it is short."""
    return f"{count / MIB:.3g} MiB" if count < 1000 * MIB else f"{count / 2**30:.3g} GiB"
