"""Detection of black, uniform and frozen pictures."""

import numpy as np

from skyherd.files.images import Grey

STEP = 8
"""Subsampling step of the tests for black and uniform pictures, px. *Chosen*: readable markers are larger."""

BLACK = 24
"""Brightest grey level of a black picture. *Chosen*: above the noise of a covered camera (about 10 levels),
below the white of a readable marker."""

EVEN = 6
"""Largest range of grey levels of a uniform picture. *Chosen*: compression noise of a single level."""

FROZEN_S = 2.0
"""Time of bitwise identical pictures above which they are frozen, s. *Chosen*: sensor noise changes pictures,
and compressed ones of a static scene change at key frames, usually within 1 s."""


class Sight:
    """Check of the content of one camera's pictures."""

    def __init__(self) -> None:
        self._last: Grey | None = None
        self._new_s = self._seen_s = 0.0

    def look(self, image: Grey, time_s: float) -> None:
        """Process a picture (height, width) that arrived at a time, s."""
        if self._last is None or not np.array_equal(image, self._last):
            self._last, self._new_s = image, time_s
        self._seen_s = time_s

    @property
    def trouble(self) -> str | None:
        """Fault of the last picture as a text, or None."""
        if self._last is None:
            return None
        sample = self._last[::STEP, ::STEP]
        low, high = int(sample.min()), int(sample.max())
        if high <= BLACK:
            return "black: no bright pixel; check the lens cover and the exposure"
        if high - low <= EVEN:
            return "one even grey: no signal, or no contrast in view"
        same_s = self._seen_s - self._new_s
        if same_s >= FROZEN_S:
            return f"frozen: identical pictures for {same_s:.1f} s; the camera or the scene is static"
        return None
