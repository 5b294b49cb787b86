"""The driver that only says what a robot would do."""

import sys
from dataclasses import replace
from typing import TextIO

from skyherd.live.drivers.link import STILL, Motion


class DryRun:
    """Prints a line when the motion changes.

    Args:
        robot_id: the robot.
        stream: where to; stdout if None.
    """

    def __init__(self, robot_id: int, stream: TextIO | None = None) -> None:
        self.name = f"dry run of robot {robot_id}"
        self._robot, self._stream = robot_id, stream
        self._last: Motion | None = None

    def write(self, motion: Motion) -> None:
        """See `Link.write`."""
        if motion == self._last or (self._last is None and replace(motion, flies=False) == STILL):
            return
        self._last = motion
        line = f"robot {self._robot}: {motion.forward_mps:+.3f} m/s, {motion.turn_radps:+.3f} rad/s"
        if motion.flies:
            line += f", left {motion.left_mps:+.3f} m/s, up {motion.up_mps:+.3f} m/s"
        stream = self._stream or sys.stdout
        stream.write(f"{line}\n")  # in one piece, since other threads write lines too
        stream.flush()

    def close(self) -> None:
        """See `Link.close`."""
