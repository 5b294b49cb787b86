"""Cameras drawn and read side by side, by helpers of the process that runs the loop.

A camera's image depends on the world at that instant, and what is detected in it on the camera's earlier
images as well, but on nothing that another camera saw. Each helper therefore reads the images of some of the
cameras for the whole run: it keeps their tracks, and sends back what it detected. Images are drawn into
memory that all of them share, so that who reads fewer images than another can draw more. The random numbers
of the noise are one sequence over all images: each helper skips those of the images that it does not draw,
so that results are the same, byte for byte, however many helpers there are.

The first step is taken by the process itself, and the helpers are forked after it: what it made (textures,
noise, compiled code, the first tracks) is theirs then, and is not made again by each of them.
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
    "a process that drew cameras has ended by itself; is there enough memory? try fewer --jobs"
)
"""What is raised if a helper is gone."""

DRAWING, READING = 1, 2
"""How long it takes to draw an image and to read it, beside each other. *Measured*: 3.4 and 6 ms in
`star`."""

WAITING = 3
"""Requests that wait in a helper before others wait in its pipe. *Derived*: to draw, to read what it drew,
and to read what another drew."""


@dataclass(frozen=True)
class HelperTasks:
    """What one helper does in a run.

    Attributes:
        draws: units whose images it draws.
        reads: units whose images it reads.
    """

    draws: frozenset[int]
    reads: frozenset[int]


def deal(units: int, helpers: int) -> list[HelperTasks]:
    """Deal the cameras of some units to as many helpers, or fewer, so that all have about as much to do.

    Cameras are read by one helper after the other in turn. Each draws what it reads, but for this: the one
    with most to do leaves drawing to the one with least, as long as the most that any has to do gets less.
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
    """The cameras of another perception, side by side; use it in a `with` block, which ends the helpers.

    What it cannot spread over processes it leaves to the other perception: all but rendered images, what
    would not survive a fork (`RenderedPerception.can_fork`), and all where processes cannot be forked.

    Args:
        perception: what to spread.
        jobs: number of cores to use; with 1, cameras are drawn one after the other.
    """

    def __init__(self, perception: Perception, jobs: int) -> None:
        self._perception, self._jobs = perception, jobs
        self._stack, self._helpers, self._shares = ExitStack(), list[Helper](), list[HelperTasks]()
        self._images: dict[int, Image] = {}
        self._begun = False
        self._spreads = jobs > 1 and can_help()

    def look(self, world: World, units: Sequence[int], time_s: float) -> Iterable[Sight]:
        """What each of the given units sees now, as soon as it is known; see `Perception.look`."""
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
        """Sights of units in their order, of each as soon as it is read, while others are read."""
        sights: dict[int, Sight] = {}
        for unit in units:
            while unit not in sights:
                sights |= reading.pop(0).answer()
            yield replace(sights[unit], image=self._images[unit].copy())

    def _ask_for_reading(self, units: set[int]) -> list[Helper]:
        """Ask for each image to be read as soon as it is drawn; return who was asked, in this order."""
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
        """Deal the cameras to helpers, one for each job, and begin these."""
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
    """What a helper does: draws the images of its share, skips the others, and reads what it is told to.

    Args:
        perception: what draws and reads.
        share: units whose images it draws.
        images: where the image of each unit is drawn, (height, width), memory that is shared.
    """

    def __init__(self, perception: RenderedPerception, share: HelperTasks, images: dict[int, Image]) -> None:
        self._perception, self._share, self._images = perception, share, images

    def serve(self, request: Shots | AbstractSet[int]) -> dict[int, Sight]:
        """Draw images; or return what some units see in theirs, without the images."""
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
