"""Ambiguous ids: markers that a unit saw at several places of one image.

A robot's marker may exist twice, for example on a spare sheet on the ground. A unit cannot read from one
image which of the two is the robot. It then controls neither, and both are bodies without identity
(`skyherd.control.avoidance.proximity`).
"""

import numpy as np

from skyherd.messages import Detections

AMBIGUOUS_S = 2.0
"""Time for which an id stays ambiguous after it was last seen at two places, s. Chosen: ten images at 5 Hz,
so that a missed detection of the robot does not turn the other marker into the robot."""


class AmbiguousIds:
    """Monitor of the ids that were recently at several places of one unit's images."""

    def __init__(self) -> None:
        self._repeated_s: dict[int, float] = {}

    def update(self, detections: Detections) -> frozenset[int]:
        """Return the ids that are ambiguous at the time of an image.

        Args:
            detections: all markers of the image, on the unit's own clock.
        """
        now_s = detections.time_s
        for marker in np.unique(detections.ids[detections.repeated]).tolist():
            self._repeated_s[marker] = now_s
        self._repeated_s = {
            marker: last_s for marker, last_s in self._repeated_s.items() if now_s - last_s <= AMBIGUOUS_S
        }
        return frozenset(self._repeated_s)
