"""Writes files so that they are there whole or not at all."""

import os
import re
import secrets
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from skyherd.errors import OutputError

PART = re.compile(r"\.skyherd-[0-9a-f]{16}\.part")
"""Names of the files that are being written; no file of a user has such a name."""


def part_of(path: Path) -> Path:
    """A new temporary name in the folder of a file, under which the file is written until it is whole."""
    return path.with_name(f".skyherd-{secrets.token_hex(8)}.part")


@contextmanager
def whole_file(path: Path) -> Iterator[Path]:
    """Give a temporary name to write to, and rename that file to `path` if the body of the `with` ends well.

    Raises:
        OutputError: it could not be written; nothing is left of it, as after any other exception.
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
    """Write a file under a temporary name beside `path`, and rename it to `path` once it is whole.

    `write` is called with the temporary path and makes the file. Returns `path`.

    Raises:
        OutputError: it could not be written; nothing is left of it.
    """
    with whole_file(path) as part:
        write(part)
    return path


def write_text(path: Path, text: str) -> Path:
    """Write a text file in UTF-8, whole or not at all; returns `path`.

    Raises:
        OutputError: it could not be written; nothing is left of it.
    """
    return write_whole(path, lambda part: part.write_text(text, "utf-8"))
