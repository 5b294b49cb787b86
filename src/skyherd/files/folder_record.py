"""Record of an output folder, `.skyherd.json`: files made by skyherd, and the current writer."""

import hashlib
import json
import os
import socket
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any

from skyherd.errors import InputError
from skyherd.files.atomic import write_text
from skyherd.files.reading import read_json
from skyherd.text import printable, shorten
from skyherd.version import __version__

RECORD = ".skyherd.json"
"""Name of the record in a folder."""

ABOUT = "Files that skyherd made in this folder. Only these may be replaced, on request."
"""Explanation inside the record."""


@dataclass(frozen=True)
class Entry:
    """Record entry of one file.

    Attributes:
        maker: the verb that made it.
        digest: SHA-256 of its content, in hexadecimal digits; None while it is written, and for a folder.
    """

    maker: str
    digest: str | None = None


def read_entries(folder: Path) -> dict[str, Entry]:
    """Read the record's entries by file name; return none if there is no record.

    Raises:
        InputError: the record is damaged.
    """
    path = folder / RECORD
    if not os.path.lexists(path):
        return {}
    allowed = "remove it; all files in the folder then count as foreign"
    record = read_json(path, allowed)
    try:
        entries = {
            str(name): Entry(str(said["made_by"]), said.get("sha256"))
            for name, said in record["files"].items()
        }
    except (AttributeError, KeyError, TypeError):
        raise InputError(str(path), "damaged", allowed) from None
    for name in entries:
        # A name that leads out of the folder would let `force` remove a file elsewhere.
        if not name or Path(name).is_absolute() or ".." in Path(name).parts:
            raise InputError(str(path), f"names {shorten(printable(name), 60)!r}", allowed)
    return entries


def write_record(folder: Path, entries: Mapping[str, Entry], *, writer: str | None = None) -> None:
    """Replace the record of a folder.

    Args:
        folder: the folder.
        entries: entry of each file, by its name.
        writer: verb that starts to write into the folder; None without one.

    Raises:
        OutputError: it cannot be written.
    """
    record: dict[str, Any] = {"about": ABOUT, "skyherd": __version__}
    if writer is not None:
        record["writer"] = {
            "verb": writer,
            "process": os.getpid(),
            "host": socket.gethostname(),
            "since": datetime.now().astimezone().isoformat(timespec="seconds"),
        }
    record["files"] = {
        name: {"made_by": entry.maker} | ({"sha256": entry.digest} if entry.digest else {})
        for name, entry in sorted(entries.items())
    }
    write_text(folder / RECORD, json.dumps(record, indent=1) + "\n")


def writer_of(folder: Path) -> str:
    """Describe the current writer of a folder according to its record."""
    try:
        writer = read_json(folder / RECORD, "")["writer"]
        return (
            f"`skyherd {writer['verb']}` writes into it (process {writer['process']} on {writer['host']}, "
            f"since {writer['since']})"
        )
    except (InputError, KeyError, TypeError):
        return "another skyherd writes into it"


def digest_of(path: Path) -> str:
    """Return the SHA-256 of a file, in hexadecimal digits."""
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()
