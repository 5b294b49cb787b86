"""Driver that only prints the commands of a robot."""

import sys
from dataclasses import replace
from typing import TextIO

from skyherd.live.drivers.link import STILL, Motion


class DryRun:
    """Link that prints a line when the motion changes.

    Args:
        robot_id: the robot.
        stream: output stream; stdout if None.
    """

    def __init__(self, robot_id: int, stream: TextIO | None = None) -> None:
        self.name = f"dry run of robot {robot_id}"
        self._robot, self._stream = robot_id, stream
        self._last: Motion | None = None

    def write(self, motion: Motion) -> None:
        """Print a motion that differs from the last one; see `Link.write`."""
        if motion == self._last or (self._last is None and replace(motion, flies=False) == STILL):
            return
        self._last = motion
        line = f"robot {self._robot}: {motion.forward_mps:+.3f} m/s, {motion.turn_radps:+.3f} rad/s"
        if motion.flies:
            line += f", left {motion.left_mps:+.3f} m/s, up {motion.up_mps:+.3f} m/s"
        stream = self._stream or sys.stdout
        stream.write(f"{line}\n")  # One call: other threads write lines too.
        stream.flush()

    def close(self) -> None:
        """Do nothing; see `Link.close`."""
