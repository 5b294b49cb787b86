"""Atomic writing: a file is complete or absent."""

import os
import re
import secrets
import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from skyherd.errors import OutputError

PART = re.compile(r"\.skyherd-[0-9a-f]{16}\.part")
"""Name pattern of files being written; no user file has such a name."""


def part_of(path: Path) -> Path:
    """Return a new temporary name in a file's folder, used until the file is complete."""
    return path.with_name(f".skyherd-{secrets.token_hex(8)}.part")


@contextmanager
def whole_file(path: Path) -> Iterator[Path]:
    """Yield a temporary name to write to, and rename that file to `path` if the `with` body succeeds.

    Raises:
        OutputError: writing failed; the temporary file is removed, as after any other exception.
    """
    part = part_of(path)
    try:
        yield part
        os.replace(part, path)
    except OutputError:
        raise
    except (OSError, UnicodeEncodeError) as error:
        why = getattr(error, "strerror", None) or error
        raise OutputError(
            f"{path}: cannot be written: {why}; free some space or choose another folder"
        ) from None
    finally:
        part.unlink(missing_ok=True)


def write_whole(path: Path, write: Callable[[Path], object]) -> Path:
    """Write a file under a temporary name beside `path`, and rename it to `path` when complete.

    `write` receives the temporary path and makes the file. Returns `path`.

    Raises:
        OutputError: writing failed; the temporary file is removed.
    """
    with whole_file(path) as part:
        write(part)
    return path


def write_text(path: Path, text: str) -> Path:
    """Write a text file in UTF-8 atomically; return `path`.

    Raises:
        OutputError: writing failed; the temporary file is removed.
    """
    return write_whole(path, lambda part: part.write_text(text, "utf-8"))


@contextmanager
def part_folder(folder: Path) -> Iterator[Path]:
    """Yield a new folder with a temporary name inside a folder; it is removed at the end of the `with` body.

    For libraries that write several files at once. The body moves the complete files to their places.

    Raises:
        OutputError: writing failed.
    """
    part = part_of(folder / "part")
    try:
        part.mkdir()
        yield part
    except OutputError:
        raise
    except OSError as error:
        why = error.strerror or error
        raise OutputError(
            f"{folder}: cannot be written: {why}; free some space or choose another folder"
        ) from None
    finally:
        shutil.rmtree(part, ignore_errors=True)


def remove_part(path: Path) -> None:
    """Remove a temporary file or folder, if it exists."""
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path, ignore_errors=True)
    else:
        path.unlink(missing_ok=True)
