"""Reading of a simulated run for an export."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from skyherd.loop import Step
from skyherd.recording.export.recorded_run import Commanded, Moment, RecordedRun, Seen, Truth
from skyherd.recording.reader import Recording, read_pictures, read_recording

DRIVING, WITHOUT_GOAL = "driving", "no fresh goal"
"""States of a robot in a simulated run, in the words of live robots."""


def read_simulated(path: Path, name: str) -> RecordedRun:
    """Read the recording of a simulated run.

    Args:
        path: the recording, `run.mcap`.
        name: name of the run.

    Raises:
        InputError: the recording is missing or unreadable.
    """
    recording = read_recording(path)
    scenario = recording.mission.scenario
    return RecordedRun(
        name=name,
        kind="simulated",
        ids=recording.mission.ids,
        units=len(scenario.units),
        side_m=scenario.marker.side_m,
        start_unix_s=0.0,
        end_s=recording.steps[-1].time_s,
        configuration=scenario.model_dump(mode="json", exclude_none=True),
        versions=recording.versions,
        moments=lambda: _moments(recording, path),
        flaws=[str(flaw) for flaw in recording.flaws],
    )


def _moments(recording: Recording, path: Path) -> Iterator[Moment]:
    """Yield the records of each step: images by unit, then the wheel commands, then the truth."""
    pictures = _Pictures(read_pictures(path) if recording.has_images else iter(()))
    for step in recording.steps:
        for unit, frame in sorted(step.frames.items()):
            decision = frame.decision
            yield Seen(
                time_s=step.time_s,
                decided_s=step.time_s,
                detections=frame.sight.detections,
                goals=decision.goals,
                proximity=decision.proximity,
                report=None if decision.suspicion else decision.report,
                flight=decision.flight,
                jpeg=pictures.of(step.time_s, unit),
            )
        yield _commanded(step)
        yield Truth(
            time_s=step.time_s,
            ids=recording.mission.ids,
            positions_m=step.positions_m,
            headings_rad=step.headings_rad,
            roles=step.roles,
            fleet=step.fleet,
            metrics=step.metrics,
        )


def _commanded(step: Step) -> Commanded:
    command = step.command
    driving = np.isin(command.ids, step.commanded_ids)
    states = tuple(DRIVING if drives else WITHOUT_GOAL for drives in driving.tolist())
    return Commanded(step.time_s, command.ids, command.v_mps, command.omega_radps, states)


class _Pictures:
    """Recorded images in the order of time and unit, of which some may be missing."""

    def __init__(self, pictures: Iterator[tuple[float, int, bytes]]) -> None:
        self._pictures = pictures
        self._next = next(pictures, None)

    def of(self, time_s: float, unit: int) -> bytes | None:
        """Return the image of a unit at a time; None without one. Calls are in the order of the images."""
        while self._next is not None and self._next[:2] < (time_s, unit):
            self._next = next(self._pictures, None)
        if self._next is None or self._next[:2] != (time_s, unit):
            return None
        return self._next[2]
