"""Writes files so that they are there whole or not at all."""

import os
from collections.abc import Callable
from pathlib import Path

from skyherd.errors import InputError, OutputError


def write_whole(path: Path, write: Callable[[Path], object]) -> Path:
    """Write a file under a temporary name beside `path`, and rename it to `path` once it is whole.

    `write` is called with the temporary path and makes the file. Returns `path`.

    Raises:
        OutputError: it could not be written; nothing is left of it.
    """
    part = path.with_name(f".{path.name}.part")
    try:
        write(part)
        os.replace(part, path)
    except OSError as error:
        why = error.strerror or error
        raise OutputError(
            f"{path}: cannot be written: {why}; free some space or choose another folder"
        ) from None
    finally:
        part.unlink(missing_ok=True)
    return path


def write_text(path: Path, text: str) -> Path:
    """Write a text file in UTF-8, whole or not at all; returns `path`.

    Raises:
        OutputError: it could not be written; nothing is left of it.
    """
    return write_whole(path, lambda part: part.write_text(text, "utf-8"))


def refuse_existing(folder: Path, *, force: bool) -> None:
    """Refuse an output folder that exists, unless `force`; nothing is touched.

    Raises:
        InputError: it is a file, or it exists and `force` is not given.
    """
    if folder.exists() and not folder.is_dir():
        raise InputError(str(folder), "is a file", "a folder to make; choose another --out")
    if folder.exists() and not force:
        raise InputError(str(folder), "exists", "another --out, or --force to write it anew")
