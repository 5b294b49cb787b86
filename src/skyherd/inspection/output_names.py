"""Names of annotated files, made of the names of the files that were looked at."""

from collections import Counter
from pathlib import Path

from skyherd.files.video_reader import is_video
from skyherd.text import printable

MAX_STEM_BYTES = 200
"""Bytes of a file's name that the annotated file's name takes over. *Chosen*: with an ending and a number it
stays below 255, the most that file systems have."""


def output_name(name: str) -> str:
    """A name for an output, made of the name of a file that may be anything: printable, and not too long."""
    plain = "".join("_" if char in '\\/:*?"<>|' else char for char in printable(name)).lstrip(".") or "_"
    return plain.encode()[:MAX_STEM_BYTES].decode(errors="ignore")


def picture_names(files: list[Path]) -> dict[Path, str]:
    """Names of the annotated files: the originals', with their whole names where two would be alike."""
    ends = {file: ".mp4" if is_video(file) else ".png" for file in files}
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
