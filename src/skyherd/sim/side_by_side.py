"""Parallel rendering and detection, by helper processes of the process that runs the loop.

The image of a camera depends on the world at that instant. Its detections also depend on earlier images of
the same camera, but not on other cameras. Each helper therefore processes the images of some of the cameras
for the whole run. It keeps their tracks, and sends back the detections. Images are rendered into shared
memory, so that a helper with fewer images to read can render more. The random numbers of the noise are one
sequence over all images. Each helper skips those of images that it does not render. Results are therefore
identical to the byte for any number of helpers.

The main process executes the first step itself, and forks the helpers afterwards. They inherit its textures,
noise, compiled code and first tracks.
"""

import mmap
import pickle
from collections.abc import Iterable, Iterator, Sequence
from collections.abc import Set as AbstractSet
from contextlib import ExitStack
from dataclasses import dataclass, replace
from types import TracebackType
from typing import Self

import numpy as np

from skyherd.errors import OutputError
from skyherd.geometry import Image
from skyherd.jobs.helpers import Helper, can_help, one_thread
from skyherd.sim.perception import RenderedPerception, Shots
from skyherd.sim.sight import Perception, Sight
from skyherd.sim.world import World

GONE = OutputError(
    "a process that drew cameras has ended by itself; is there enough memory? try fewer `jobs=`"
)
"""Error raised if a helper has ended."""

DRAWING, READING = 3, 4
"""Relative times of rendering and reading an image. Measured: 3.1 and 4.0 ms in `star`."""

WAITING = 3
"""Number of requests that wait in a helper before others wait in its pipe. Derived: to render, to read the
own images, and to read those of another helper."""


@dataclass(frozen=True)
class HelperTasks:
    """Cameras of one helper in a run.

    Attributes:
        draws: units whose images it renders.
        reads: units whose images it reads.
    """

    draws: frozenset[int]
    reads: frozenset[int]


def deal(units: int, helpers: int) -> list[HelperTasks]:
    """Distribute the cameras of some units to helpers with balanced work.

    Cameras are assigned for reading in turn. Each helper first renders the images that it reads. Then the
    helper with the most work transfers rendering to the one with the least, while this reduces the maximum.
    """
    reads = [set(range(first, units, helpers)) for first in range(helpers)]
    draws = [set(own) for own in reads]
    while True:
        work = [DRAWING * len(drawn) + READING * len(read) for drawn, read in zip(draws, reads, strict=True)]
        most, least = work.index(max(work)), work.index(min(work))
        if work[least] + DRAWING >= work[most]:
            return [HelperTasks(frozenset(d), frozenset(r)) for d, r in zip(draws, reads, strict=True)]
        unit = max(draws[most])
        draws[most].remove(unit)
        draws[least].add(unit)


class SideBySide(Perception):
    """Parallel version of another perception; use it in a `with` block, which ends the helpers.

    It parallelizes only rendered images. It delegates to the other perception if that perception does not
    survive a fork (`RenderedPerception.can_fork`), or if processes cannot be forked.

    Args:
        perception: the perception to parallelize.
        jobs: number of cores to use; with 1, cameras are processed one after the other.
    """

    def __init__(self, perception: Perception, jobs: int) -> None:
        self._perception, self._jobs = perception, jobs
        self._stack, self._helpers, self._shares = ExitStack(), list[Helper](), list[HelperTasks]()
        self._images: dict[int, Image] = {}
        self._begun = False
        self._spreads = jobs > 1 and can_help()

    def look(self, world: World, units: Sequence[int], time_s: float) -> Iterable[Sight]:
        """Return the output of each unit's camera as soon as it is available; see `Perception.look`."""
        perception = self._perception
        begun, self._begun = self._begun, self._begun or bool(units)
        spreads = self._spreads and begun and len(world.cameras) > 1
        if not (spreads and isinstance(perception, RenderedPerception) and perception.can_fork):
            return perception.look(world, units, time_s)
        if not self._helpers:
            self._fork(perception, [camera.size_px for camera in world.cameras])
        if not units:
            return []
        request = pickle.dumps(perception.shots(world, units, time_s), pickle.HIGHEST_PROTOCOL)
        for helper in self._helpers:
            helper.send(request)
        return self._sights(units, self._ask_for_reading(set(units)))

    def _sights(self, units: Sequence[int], reading: list[Helper]) -> Iterator[Sight]:
        """Yield the sights of units in their order, each as soon as it is read."""
        sights: dict[int, Sight] = {}
        for unit in units:
            while unit not in sights:
                sights |= reading.pop(0).answer()
            yield replace(sights[unit], image=self._images[unit].copy())

    def _ask_for_reading(self, units: set[int]) -> list[Helper]:
        """Request to read each image once it is rendered; return the helpers in the order of requests."""
        asked = []

        def ask(reader: int, images: AbstractSet[int]) -> None:
            if images:
                self._helpers[reader].ask(images)
                asked.append(self._helpers[reader])

        for number, share in enumerate(self._shares):
            ask(number, share.draws & share.reads & units)
        for drawer, share in zip(self._helpers, self._shares, strict=True):
            drawer.answer()
            for number, other in enumerate(self._shares):
                ask(number, share.draws & other.reads & units - share.reads)
        return asked

    def _fork(self, perception: RenderedPerception, sizes_px: list[tuple[int, int]]) -> None:
        """Distribute the cameras to helpers, one for each job, and start them."""
        for unit, (width, height) in enumerate(sizes_px):
            shared = mmap.mmap(-1, width * height)
            self._images[unit] = np.frombuffer(shared, np.uint8).reshape(height, width)
        self._stack.enter_context(one_thread())
        self._shares = deal(len(sizes_px), min(self._jobs, len(sizes_px)))
        for share in self._shares:
            helper = Helper(_Photographer(perception, share, self._images).serve, GONE, waiting=WAITING)
            self._helpers.append(self._stack.enter_context(helper))

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._stack.close()
        self._helpers.clear()


class _Photographer:
    """Work of a helper: render the images of its share, skip the others, and read on request.

    Args:
        perception: renderer and detector.
        share: cameras of the helper.
        images: shared memory for the image (height, width) of each unit.
    """

    def __init__(self, perception: RenderedPerception, share: HelperTasks, images: dict[int, Image]) -> None:
        self._perception, self._share, self._images = perception, share, images

    def serve(self, request: Shots | AbstractSet[int]) -> dict[int, Sight]:
        """Render images, or return the sights of some units without the images."""
        if isinstance(request, Shots):
            self._shots = request
            for shot in request.of_units:
                if shot.stream in self._share.draws:
                    self._images[shot.stream][:] = self._perception.renderer.render(shot)
                else:
                    self._perception.skip(shot)
            return {}
        sights = {}
        for shot in self._shots.of_units:
            if shot.stream in request:
                sight = self._perception.read(shot, self._shots.time_s, self._images[shot.stream])
                sights[shot.stream] = replace(sight, image=None)
        return sights
