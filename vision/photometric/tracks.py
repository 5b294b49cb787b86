"""Where markers will be in the next image, extrapolated from the last two.

Two kinds of motion are told apart. A robot on an arc, or a camera that turns or zooms, moves a marker's
centre by steps that turn and grow as the marker's arm does; a camera that flies past moves it by equal steps.
Each marker's next step is taken to be of the kind that its last step was nearer to.
"""

from dataclasses import dataclass

import numpy as np

from skyherd.geometry import SQUARE_CORNERS, Array, BoolArray, ComplexArray, IntArray
from skyherd.vision.photometric.fitting.local_homography import LocalHomographies


@dataclass(frozen=True)
class Tracks:
    """The markers being followed, as they were in the last image.

    Attributes:
        time_s: when the last image was taken.
        ids: (N,) marker ids.
        homographies: of the markers in the last image.
        velocities: (N,) of the centres, px/s, complex; zero for a marker seen once.
        arm_log_rates: (N,) rates of the arms' logarithms, 1/s: real part growth, imaginary part rotation.
        on_arc: (N,) whether the centres' steps turn and grow with the arms.
        sigmas_px: (N,) standard deviations of the blur, lens and pixel together, px.
    """

    time_s: float
    ids: IntArray
    homographies: LocalHomographies
    velocities: ComplexArray
    arm_log_rates: ComplexArray
    on_arc: BoolArray
    sigmas_px: Array

    def elapsed_s(self, time_s: float) -> float:
        """Return the time since the last image, s; 1 if the images' times do not increase."""
        return time_s - self.time_s if time_s > self.time_s else 1.0

    def predicted(self, time_s: float) -> LocalHomographies:
        """Return the homographies expected at `time_s`.

        Arms go on turning and growing at their rates; so do the steps of centres `on_arc`, while the other
        centres go on straight. The squeezes, which are fixed in image axes, turn with the arms.
        """
        elapsed = self.elapsed_s(time_s)
        turn = np.exp(self.arm_log_rates * elapsed)
        return LocalHomographies(
            centers=self.homographies.centers + self.velocities * np.where(self.on_arc, turn, 1) * elapsed,
            arms=self.homographies.arms * turn,
            squeezes=self.homographies.squeezes * turn.conj(),
            horizons=self.homographies.horizons,
        )

    def updated(
        self, time_s: float, ids: IntArray, homographies: LocalHomographies, sigmas_px: Array
    ) -> "Tracks":
        """Return the tracks after an image at `time_s` that shows markers `ids` (N,) at `homographies`.

        Markers that were followed before get a velocity; markers that are not among `ids` are dropped.
        """
        elapsed = self.elapsed_s(time_s)
        velocities, rates = np.zeros((2, ids.size), dtype=complex)
        on_arc = np.ones(ids.size, dtype=bool)
        now, before = np.nonzero(ids[:, None] == self.ids)
        velocities[now] = (homographies.centers[now] - self.homographies.centers[before]) / elapsed
        rates[now] = np.log(homographies.arms[now] / self.homographies.arms[before]) / elapsed
        straight = self.velocities[before]
        turned = straight * np.exp(self.arm_log_rates[before] * elapsed)
        on_arc[now] = np.abs(velocities[now] - turned) <= np.abs(velocities[now] - straight)
        return Tracks(time_s, ids, homographies, velocities, rates, on_arc, sigmas_px)

    def with_others(self, ids: IntArray, homographies: LocalHomographies, sigmas_px: Array) -> "Tracks":
        """Return the tracks if the last image shows markers `ids` (N,) at `homographies`, too.

        They are taken to stand still. What is at two places then is not followed any more. Ids ascend.
        """
        kept = np.flatnonzero(~np.isin(self.ids, ids))
        once = np.flatnonzero(((ids[:, None] == ids).sum(axis=1) == 1) & ~np.isin(ids, self.ids))
        order = np.argsort(np.concatenate([self.ids[kept], ids[once]]))
        rest = np.zeros(once.size, dtype=complex)
        return Tracks(
            time_s=self.time_s,
            ids=np.concatenate([self.ids[kept], ids[once]])[order],
            homographies=self.homographies.take(kept).joined(homographies.take(once)).take(order),
            velocities=np.concatenate([self.velocities[kept], rest])[order],
            arm_log_rates=np.concatenate([self.arm_log_rates[kept], rest])[order],
            on_arc=np.concatenate([self.on_arc[kept], np.ones(once.size, dtype=bool)])[order],
            sigmas_px=np.concatenate([self.sigmas_px[kept], sigmas_px[once]])[order],
        )


def no_tracks() -> Tracks:
    """Return tracks of no marker, at time 0."""
    empty = np.zeros(0, dtype=complex)
    return Tracks(
        time_s=0.0,
        ids=np.zeros(0, dtype=np.int64),
        homographies=LocalHomographies(empty, empty, empty, empty),
        velocities=empty,
        arm_log_rates=empty,
        on_arc=np.zeros(0, dtype=bool),
        sigmas_px=np.zeros(0),
    )


def in_view(homographies: LocalHomographies, image_shape: tuple[int, ...]) -> BoolArray:
    """Return which markers (N,) have their centres inside an image (height, width)."""
    height, width = image_shape
    from_middle = homographies.centers - complex(width - 1, height - 1) / 2
    return np.asarray((np.abs(from_middle.real) < width / 2) & (np.abs(from_middle.imag) < height / 2))


def is_whole(homographies: LocalHomographies, image_shape: tuple[int, ...]) -> BoolArray:
    """Return which markers (N,) have all of their corners inside an image (height, width)."""
    height, width = image_shape
    corners = homographies.images(SQUARE_CORNERS)
    inside = (np.abs(corners.real - (width - 1) / 2) < width / 2) & (
        np.abs(corners.imag - (height - 1) / 2) < height / 2
    )
    return np.asarray(inside.all(axis=1))
