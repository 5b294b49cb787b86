"""Names of annotated files, derived from the names of the input files."""

from collections import Counter
from pathlib import Path

from skyherd.files.image_streams import is_stream
from skyherd.text import printable

MAX_STEM_BYTES = 200
"""Bytes of an input name that an annotated file's name keeps. *Chosen*: with suffix and number it stays
below 255, the limit of file systems."""


def output_name(name: str) -> str:
    """Return a printable output name of limited length for any file name."""
    plain = "".join("_" if char in '\\/:*?"<>|' else char for char in printable(name)).lstrip(".") or "_"
    return plain.encode()[:MAX_STEM_BYTES].decode(errors="ignore")


def picture_names(files: list[Path]) -> dict[Path, str]:
    """Return the names of the annotated files; equal stems keep their whole names."""
    ends = {file: ".mp4" if is_stream(file) else ".png" for file in files}
    stems = {file: output_name(file.stem) for file in files}
    often = Counter(stems[file] + ends[file] for file in files)
    named = {
        file: stems[file] if often[stems[file] + ends[file]] == 1 else output_name(file.name)
        for file in files
    }
    taken: set[str] = set()
    names = {}
    for file, stem in named.items():
        tries = (
            f"{stem}{number}{ends[file]}" for number in ("", *(f"-{k}" for k in range(2, len(files) + 2)))
        )
        names[file] = next(name for name in tries if name not in taken)
        taken.add(names[file])
    return names
