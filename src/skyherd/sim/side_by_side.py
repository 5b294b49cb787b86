"""Cameras drawn and read side by side, by helpers of the process that runs the loop.

A camera's image and what is detected in it depend on the world at that instant, on the camera's earlier
images, and on nothing that another camera saw. Each helper therefore has some of the cameras for the whole
run: it keeps their tracks, and sends back what it detected; images come back through memory that is shared.
The random numbers of the noise are one sequence over all images: each helper skips those of the images that
it does not make, so that results are the same, byte for byte, however many helpers there are.

The first step is taken by the process itself, and the helpers are forked after it: what it made (textures,
noise, compiled code, the first tracks) is theirs then, and is not made again by each of them.
"""

import mmap
import pickle
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import replace
from types import TracebackType
from typing import Self

import numpy as np

from skyherd.errors import OutputError
from skyherd.jobs.helpers import Helper, can_help, one_thread
from skyherd.sim.perception import Image, Perception, RenderedPerception, Scene, Sight
from skyherd.sim.world import World

GONE = OutputError(
    "a process that drew cameras has ended by itself; is there enough memory? try fewer --jobs"
)
"""What is raised if a helper is gone."""


class SideBySide(Perception):
    """The cameras of another perception, side by side; use it in a `with` block, which ends the helpers.

    What it cannot spread over processes it leaves to the other perception: all but rendered images, what
    would not survive a fork (`RenderedPerception.can_fork`), and all where processes cannot be forked.

    Args:
        perception: what to spread.
        jobs: number of cores to use; with 1, cameras are drawn one after the other.
    """

    def __init__(self, perception: Perception, jobs: int) -> None:
        self._perception, self._jobs = perception, jobs
        self._stack, self._helpers = ExitStack(), list[Helper]()
        self._images: dict[int, Image] = {}
        self._begun = False
        self._spreads = jobs > 1 and can_help()

    def look(self, world: World, units: Sequence[int], time_s: float) -> list[Sight]:
        """What each of the given units sees now, of several at a time; see `Perception.look`."""
        perception = self._perception
        begun, self._begun = self._begun, self._begun or bool(units)
        spreads = self._spreads and begun and len(world.cameras) > 1
        if not (spreads and isinstance(perception, RenderedPerception) and perception.can_fork):
            return perception.look(world, units, time_s)
        if not self._helpers:
            self._fork(perception, [camera.size_px for camera in world.cameras])
        if not units:
            return []
        request = pickle.dumps(perception.scene(world, units, time_s), pickle.HIGHEST_PROTOCOL)
        for helper in self._helpers:
            helper.send(request)
        sights = {unit: sight for helper in self._helpers for unit, sight in helper.answer().items()}
        return [replace(sights[unit], image=self._images[unit].copy()) for unit in units]

    def _fork(self, perception: RenderedPerception, sizes_px: list[tuple[int, int]]) -> None:
        """Deal the cameras to helpers, one more than there are jobs, and begin these.

        Three cameras on two cores take 1.5 times as long as one if the system may share out the cores among
        three processes, and twice as long as one if two of them are one process.
        """
        for unit, (width, height) in enumerate(sizes_px):
            shared = mmap.mmap(-1, width * height)
            self._images[unit] = np.frombuffer(shared, np.uint8).reshape(height, width)
        self._stack.enter_context(one_thread())
        helpers = min(self._jobs + 1, len(sizes_px))
        for first in range(helpers):
            own = {unit: self._images[unit] for unit in range(first, len(sizes_px), helpers)}
            helper = Helper(_Photographer(perception, own).take, GONE)
            self._helpers.append(self._stack.enter_context(helper))

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._stack.close()
        self._helpers.clear()


class _Photographer:
    """What a helper does: takes the images of its own cameras, and skips those of the others.

    Args:
        perception: what takes them.
        images: where the image of each of its own units goes, (height, width), memory that is shared.
    """

    def __init__(self, perception: RenderedPerception, images: dict[int, Image]) -> None:
        self._perception, self._images = perception, images

    def take(self, scene: Scene) -> dict[int, Sight]:
        """What its own units see, without the images, which are left in the shared memory."""
        sights = {}
        for view in scene.views:
            if view.unit not in self._images:
                self._perception.skip(view)
                continue
            sight = self._perception.take(scene, view)
            if sight.image is not None:
                self._images[view.unit][:] = sight.image
            sights[view.unit] = replace(sight, image=None)
        return sights
