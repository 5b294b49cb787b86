"""Detection of mirrored cameras, such as many webcams."""

from skyherd.live.cameras.frame import Clock, Frame
from skyherd.messages import Detections
from skyherd.vision import explain_mirrored

FIRST_S, MAX_S = 2.0, 60.0
"""First and longest interval between two searches of the mirror image, s; it doubles each time. *Chosen*: a
camera is mirrored from its start, and a search costs two detections."""

FEW = 3
"""Markers that exclude a mirrored picture. *Chosen*: some markers are their own mirror image."""


class MirrorWatch:
    """Detector of mirrored cameras. It searches the mirror image while few markers are detected.

    Args:
        dictionary: marker dictionary.
        clock: returns the time, s.
    """

    def __init__(self, dictionary: str, clock: Clock) -> None:
        self._dictionary, self._clock = dictionary, clock
        self._every_s, self._next_s = FIRST_S, clock() + FIRST_S
        self.trouble: str | None = None
        """Advice about a mirrored picture; None for other pictures."""

    def look(self, frame: Frame, found: Detections) -> str | None:
        """Return advice if the frame is mirrored, given its detected markers, or None."""
        if len(found) >= FEW:
            self.trouble, self._every_s = None, FIRST_S
            self._next_s = self._clock() + FIRST_S
        elif self._clock() >= self._next_s:
            self.trouble = explain_mirrored(frame.image, self._dictionary)
            self._every_s = min(2 * self._every_s, MAX_S)
            self._next_s = self._clock() + self._every_s
        return self.trouble
