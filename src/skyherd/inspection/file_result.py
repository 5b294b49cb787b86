"""Detection result of one file, for people."""

from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path

from skyherd.errors import InputError
from skyherd.vision import DEFAULT_DICTIONARY, Rejection


@dataclass
class FileResult:
    """Detection result of one file.

    Attributes:
        file: the picture or video.
        dictionary: dictionary of the markers searched for.
        frames: number of processed images.
        ids: number of detections of each marker.
        rejections: all of a picture; those of the last frame of a video.
        reasons: number of rejections by reason.
        hint: advice if little was detected; None if enough was, or nothing helps.
        trouble: reason why the file could not be read; None if it could.
        picture: the annotated picture or video; None if the file could not be read.
    """

    file: Path
    dictionary: str = DEFAULT_DICTIONARY
    frames: int = 0
    ids: Counter[int] = field(default_factory=Counter)
    rejections: list[Rejection] = field(default_factory=list)
    reasons: Counter[str] = field(default_factory=Counter)
    hint: str | None = None
    trouble: InputError | None = None
    picture: Path | None = None
