"""Pictures in files: videos, and folders of images."""

import os
import time
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Literal

from skyherd.errors import InputError
from skyherd.files.images import SUFFIXES, read_grey
from skyherd.files.reading import is_regular
from skyherd.files.video_reader import ClipFrame, open_clip, read_clip
from skyherd.live.cameras.frame import Picture

POLL_S = 0.02
"""Polling period of a growing folder, s. *Chosen*: below the frame interval of a camera."""

UNFINISHED_S = 2.0
"""Time since its last change for which an unreadable picture counts as incomplete, s; later it is skipped.
*Chosen*: no picture takes longer to write."""


class VideoFile:
    """A video file, played at its own pace or as fast as its pictures are taken.

    Args:
        path: a regular file with a video.
        pace: `own` or `fast`.
    """

    lasting = False

    def __init__(self, path: Path, pace: Literal["own", "fast"]) -> None:
        self.name, self._path = str(path), path
        self.pace: Literal["own", "fast"] = pace

    @contextmanager
    def open(self, pause: Callable[[float], bool]) -> Iterator[Iterator[Picture]]:
        """Open the video. Times count from its first picture; see `Source.open`."""
        with closing(read_clip(open_clip(self._path))) as frames:
            yield self._pictures(frames)

    def _pictures(self, frames: Iterator[ClipFrame]) -> Iterator[Picture]:
        first_s: float | None = None
        for frame in frames:
            first_s = frame.time_s if first_s is None else first_s
            yield Picture(frame.image, frame.time_s - first_s)


class ImageFolder:
    """A folder of pictures, complete or written by a camera.

    `fast` reads the existing pictures in the order of their names, and ends. `live` reads the newest picture,
    and then each added or changed one, also if the clock was set back. The time of a picture is the last
    change of its file.

    Args:
        path: the folder.
        pace: `fast` or `live`.
    """

    def __init__(self, path: Path, pace: Literal["live", "fast"]) -> None:
        self.name, self._path = str(path), path
        self.pace: Literal["live", "fast"] = pace
        self.lasting = pace == "live"

    @contextmanager
    def open(self, pause: Callable[[float], bool]) -> Iterator[Iterator[Picture]]:
        """Open the folder; see `Source.open`."""
        found = self._files()
        if self.pace == "fast" and not found:
            raise InputError(self.name, "no picture in this folder", f"names that end in {_endings()}")
        yield self._recorded(found) if self.pace == "fast" else self._growing(found, pause)

    def _files(self) -> list[tuple[int, str]]:
        """Return the time of the last change, ns, and the name of each picture, sorted.

        Raises:
            InputError: the folder cannot be read.
        """
        try:
            with os.scandir(self._path) as entries:
                return sorted(
                    (entry.stat().st_mtime_ns, entry.name)
                    for entry in entries
                    if Path(entry.name).suffix.lower() in SUFFIXES and is_regular(Path(entry.path))
                )
        except OSError as error:
            raise InputError(self.name, f"cannot be read: {error.strerror}", "a folder of pictures") from None

    def _recorded(self, found: list[tuple[int, str]]) -> Iterator[Picture]:
        """Yield all pictures by name, with the times of their files' last changes since the first one."""
        first_ns = min(changed_ns for changed_ns, _ in found)
        last_s = 0.0
        for changed_ns, name in sorted(found, key=lambda file: file[1]):
            last_s = max(last_s, (changed_ns - first_ns) / 1e9)
            yield Picture(read_grey(self._path / name), last_s)

    def _growing(self, found: list[tuple[int, str]], pause: Callable[[float], bool]) -> Iterator[Picture]:
        """Yield the newest picture, and then all new ones."""
        taken = {name: changed_ns for changed_ns, name in found[:-1]}
        while True:
            files = self._files()
            taken = {name: taken[name] for _, name in files if name in taken}
            for changed_ns, name in [file for file in files if taken.get(file[1]) != file[0]]:
                age_s = time.time() - changed_ns / 1e9
                try:
                    image = read_grey(self._path / name)
                except InputError:
                    if abs(age_s) < UNFINISHED_S:
                        break
                    taken[name] = changed_ns
                    continue
                taken[name] = changed_ns
                yield Picture(image, age_s=age_s)
            if pause(POLL_S):
                return


def _endings() -> str:
    return ", ".join(sorted(SUFFIXES))
