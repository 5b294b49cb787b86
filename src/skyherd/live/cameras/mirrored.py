"""Says that a camera's pictures are mirrored, as webcams' often are."""

from skyherd.live.cameras.frame import Clock, Frame
from skyherd.messages import Detections
from skyherd.vision import explain_mirrored

FIRST_S, MAX_S = 2.0, 60.0
"""How long after nothing was found the mirror image is looked at, and then ever later up to once in so long,
s. *Chosen*: a camera is mirrored from its start; the look costs two detections."""

FEW = 3
"""With fewer markers found the picture may be mirrored. *Chosen*: some markers are their own mirror image."""


class MirrorWatch:
    """Looks at the mirror image of a camera's pictures while next to no marker is found in them.

    Args:
        dictionary: of the markers.
        clock: gives the time, s.
    """

    def __init__(self, dictionary: str, clock: Clock) -> None:
        self._dictionary, self._clock = dictionary, clock
        self._every_s, self._next_s = FIRST_S, clock() + FIRST_S
        self.trouble: str | None = None
        """What to do about a picture that is mirrored, in words; None as long as none is."""

    def look(self, frame: Frame, found: Detections) -> str | None:
        """What is wrong, given a frame and the markers found in it; None if nothing is."""
        if len(found) >= FEW:
            self.trouble, self._every_s = None, FIRST_S
            self._next_s = self._clock() + FIRST_S
        elif self._clock() >= self._next_s:
            self.trouble = explain_mirrored(frame.image, self._dictionary)
            self._every_s = min(2 * self._every_s, MAX_S)
            self._next_s = self._clock() + self._every_s
        return self.trouble
