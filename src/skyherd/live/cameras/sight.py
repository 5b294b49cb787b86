"""Whether a camera still shows anything: black, even and frozen pictures."""

import numpy as np

from skyherd.live.cameras.frame import Grey

STEP = 8
"""Every eighth pixel of every eighth row is looked at for black. *Chosen*: a marker that can be read is
larger."""

BLACK = 24
"""A picture without a brighter level is black. *Chosen*: above the noise of a covered camera (some 10
levels), and below the white of a marker that can be read."""

EVEN = 6
"""A picture whose levels differ by no more shows nothing. *Chosen*: what compression leaves of one level."""

FROZEN_S = 2.0
"""The same picture, to the bit, for so long is said to be frozen. *Chosen*: a sensor's noise changes every
picture; a compressed one of a scene at rest may stay the same from one key frame to the next, usually for
a second or less."""


class Sight:
    """What is wrong with the pictures of one camera, from one to the next."""

    def __init__(self) -> None:
        self._last: Grey | None = None
        self._new_s = self._seen_s = 0.0

    def look(self, image: Grey, time_s: float) -> None:
        """Look at a picture (height, width) that came in at a time, s."""
        if self._last is None or not np.array_equal(image, self._last):
            self._last, self._new_s = image, time_s
        self._seen_s = time_s

    @property
    def trouble(self) -> str | None:
        """What is wrong with the last picture, in words; None if nothing is."""
        if self._last is None:
            return None
        sample = self._last[::STEP, ::STEP]
        low, high = int(sample.min()), int(sample.max())
        if high <= BLACK:
            return "black: no pixel is bright; is the lens covered, or the exposure too short?"
        if high - low <= EVEN:
            return "one even grey: no signal, or nothing in view"
        same_s = self._seen_s - self._new_s
        if same_s >= FROZEN_S:
            return f"frozen: the same picture for {same_s:.1f} s, to the last bit, or nothing in it moves"
        return None
