"""Where markers will be in the next image: each goes on as it went from the last but one to the last.

A step that turns and grows as the marker does is what a robot on an arc makes, or a camera that turns or
zooms; a camera that flies past makes steps that do not. Each marker's next step is taken to be of the kind
that its last one was nearer to.
"""

from dataclasses import dataclass

import numpy as np

from skyherd.geometry import BoolArray, ComplexArray, IntArray
from skyherd.vision.photometric.local_homography import Shapes


@dataclass(frozen=True)
class Tracks:
    """Markers being followed.

    Attributes:
        time_s: of the image they were last seen in.
        ids: (N,).
        shapes: as last seen.
        velocities: (N,) of the centres, px/s; zero for a marker seen once.
        growths: (N,) of the arms, 1/s: real part growth, imaginary part turn.
        turning: (N,) whether the centres' steps turn and grow with the arms.
    """

    time_s: float
    ids: IntArray
    shapes: Shapes
    velocities: ComplexArray
    growths: ComplexArray
    turning: BoolArray

    def elapsed_s(self, time_s: float) -> float:
        """Time since the last image; 1 for images that come without times."""
        return time_s - self.time_s if time_s > self.time_s else 1.0

    def predicted(self, time_s: float) -> Shapes:
        """Shapes at `time_s`: arms go on turning and growing, and so do the steps of centres that turn."""
        elapsed = self.elapsed_s(time_s)
        turn = np.exp(self.growths * elapsed)
        return Shapes(
            self.shapes.centers + self.velocities * np.where(self.turning, turn, 1) * elapsed,
            self.shapes.arms * turn,
            self.shapes.squeezes * turn.conj(),
            self.shapes.horizons,
        )

    def seen(self, time_s: float, ids: IntArray, shapes: Shapes) -> "Tracks":
        """Tracks of the markers in the next image; those followed before have a velocity."""
        elapsed = self.elapsed_s(time_s)
        velocities, growths = np.zeros((2, ids.size), dtype=complex)
        turning = np.ones(ids.size, dtype=bool)
        now, before = np.nonzero(ids[:, None] == self.ids)
        velocities[now] = (shapes.centers[now] - self.shapes.centers[before]) / elapsed
        growths[now] = np.log(shapes.arms[now] / self.shapes.arms[before]) / elapsed
        straight = self.velocities[before]
        turned = straight * np.exp(self.growths[before] * elapsed)
        turning[now] = np.abs(velocities[now] - turned) <= np.abs(velocities[now] - straight)
        return Tracks(time_s, ids, shapes, velocities, growths, turning)


def no_tracks() -> Tracks:
    """Nothing followed yet."""
    none = np.zeros(0, dtype=complex)
    return Tracks(0.0, np.zeros(0, dtype=np.int64), Shapes(none, none, none, none), none, none, none.real > 0)


def in_view(shapes: Shapes, image_shape: tuple[int, ...]) -> BoolArray:
    """Which markers (N,) have their centres in an image (height, width)."""
    height, width = image_shape
    from_middle = shapes.centers - complex(width - 1, height - 1) / 2
    return np.asarray((np.abs(from_middle.real) < width / 2) & (np.abs(from_middle.imag) < height / 2))
