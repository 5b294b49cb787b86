"""Files that are written once, under a name that no other file has."""

import os
from itertools import count
from pathlib import Path

from skyherd.errors import OutputError


def write_new_file(folder: Path, stem: str, suffix: str, text: str) -> Path:
    """Write a text into a new file and return its path; no existing file is replaced.

    Args:
        folder: an existing folder.
        stem: first choice of the name; `-2`, `-3` … follow it while the name is taken.
        suffix: end of the name, with its dot.
        text: content of the file, UTF-8.

    Raises:
        OutputError: the file cannot be written.
    """
    for number in count(1):
        path = folder / f"{stem}{f'-{number}' if number > 1 else ''}{suffix}"
        try:
            descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o666)
        except FileExistsError:
            continue
        except OSError as error:
            raise OutputError(f"{path}: cannot be written: {error.strerror}; choose another folder") from None
        try:
            with open(descriptor, "w", encoding="utf-8") as file:
                file.write(text)
        except OSError as error:
            path.unlink()
            raise OutputError(f"{path}: cannot be written: {error.strerror}; free some space") from None
        return path
    raise AssertionError("the numbers of files do not end")
