"""Cameras of a scenario that freeze, lag or replay old images with fresh time stamps."""

from collections import deque
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace

from skyherd.datasets import CameraFaultModel, Mission
from skyherd.messages import TIME_TOLERANCE_S
from skyherd.sim.sight import Perception, Sight
from skyherd.sim.world import World


class FaultyCameras(Perception):
    """Perception that replaces the images of faulty cameras by earlier ones, with the present time.

    Args:
        perception: perception of the scenario. It takes all images, so that its random numbers stay the same.
        faults: faults of each unit's camera.
    """

    def __init__(self, perception: Perception, faults: Sequence[Sequence[CameraFaultModel]]) -> None:
        self._perception = perception
        self._faults = {unit: list(own) for unit, own in enumerate(faults) if own}
        self._past: dict[int, deque[Sight]] = {unit: deque() for unit in self._faults}

    def look(self, world: World, units: Sequence[int], time_s: float) -> Iterable[Sight]:
        """Return the output of each unit's camera; see `Perception.look`."""
        sights = self._perception.look(world, units, time_s)
        return self._shown(units, sights, time_s) if self._faults else sights

    def _shown(self, units: Sequence[int], sights: Iterable[Sight], time_s: float) -> Iterator[Sight]:
        for unit, sight in zip(units, sights, strict=True):
            yield self._show(unit, sight, time_s) if unit in self._faults else sight

    def _show(self, unit: int, sight: Sight, time_s: float) -> Sight:
        """Return the image that a faulty camera shows instead of its present one."""
        past, faults = self._past[unit], self._faults[unit]
        past.append(sight)
        oldest_s = min((fault.oldest_s(time_s) for fault in faults if time_s < fault.end_s), default=time_s)
        while len(past) > 1 and past[1].detections.time_s <= oldest_s + TIME_TOLERANCE_S:
            past.popleft()
        for fault in faults:
            if fault.start_s <= time_s < fault.end_s:
                shown_s = fault.shown_s(time_s) + TIME_TOLERANCE_S
                old = next((one for one in reversed(past) if one.detections.time_s <= shown_s), past[0])
                return replace(old, detections=replace(old.detections, time_s=time_s))
        return sight


def with_camera_faults(perception: Perception, mission: Mission) -> Perception:
    """Return a perception with the camera faults of a scenario; the same one if there are none."""
    faults = [unit.camera.faults for unit in mission.scenario.units]
    return FaultyCameras(perception, faults) if any(faults) else perception
