"""What was found in one file, for people."""

from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path

from skyherd.errors import InputError
from skyherd.vision import DEFAULT_DICTIONARY, Rejection


@dataclass
class FileResult:
    """What was found in one file.

    Attributes:
        file: the picture or video.
        dictionary: of the markers that were looked for.
        frames: number of images that were looked at.
        ids: how often each marker was detected.
        rejections: of a picture, all; of a video, those of its last frame.
        reasons: how often each reason for a rejection was given.
        hint: what to try if little was detected, in words; None if enough was, or nothing helps.
        trouble: why the file could not be read; None if it could.
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
