"""State of a running lab for the page, and the page's request to stop."""

import shutil
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from skyherd.live.cockpit.previews import Preview, read_preview
from skyherd.live.cockpit.server import PageAddress, Server
from skyherd.live.lab import Lab
from skyherd.live.lab.camera_survey import GOOD_MARKER_PX, Finding, Level, team_findings
from skyherd.live.operator import Watch

SEEN_S = 2.0
"""Time for which a robot counts as seen, s. Chosen: four pictures."""

STALE_S = 3.0
"""Age of a picture from which on it is marked as old, s. Chosen: six pictures."""


@dataclass(frozen=True)
class ProcessState:
    """State of one process for the page.

    Attributes:
        name: such as `robot/3`.
        starts: number of starts.
        armed: whether a robot is armed; None for other processes, and before its first heartbeat.
        state: its state in words.
    """

    name: str
    starts: int
    armed: bool | None
    state: str


class Cockpit:
    """Page of a running lab. All methods are called by the thread of the session.

    Attributes:
        url: address to open, with its token; empty without a page.

    Args:
        lab: the set-up.
        folder: folder of the units' pictures; removed at the end.
        address: where the page is served. None: there is no page, and nothing asks to stop.

    Raises:
        InputError: the address is not one of this computer, or its port is in use.
    """

    def __init__(self, lab: Lab, folder: Path, address: PageAddress | None) -> None:
        self._lab, self._folder = lab, folder
        self._units = len(lab.model.cameras)
        self._server = None
        if address is not None:
            self._server = Server(address, folder, self._units, f"team {lab.model.team}")
        self.url = "" if self._server is None else self._server.access.url
        self._seen_s: list[dict[int, float]] = [{} for _ in range(self._units)]

    def stop_asked(self) -> bool:
        """Return whether the page asked to stop since the last call."""
        return self._server is not None and self._server.stop_asked()

    def show(self, processes: Sequence[ProcessState], watched: Watch, lines: Sequence[str]) -> None:
        """Show the state of the team.

        Args:
            processes: all processes of the run.
            watched: the operator's view of the team.
            lines: the newest lines of the log.
        """
        if self._server is None:
            return
        previews = [read_preview(self._folder, unit) for unit in range(self._units)]
        now_s = time.monotonic()
        for last_s, preview in zip(self._seen_s, previews, strict=True):
            if preview is not None:
                last_s.update(dict.fromkeys(preview[0].seen, now_s - preview[1]))
        seen = [
            {robot for robot, at_s in last_s.items() if now_s - at_s <= SEEN_S} for last_s in self._seen_s
        ]
        owners = [set() if one is None else set(one[0].controlled) for one in previews]
        states = {process.name: process for process in processes}
        self._server.publish(
            {
                "armed": sum(bool(process.armed) for process in processes),
                "stopped": watched.latch.stopped,
                "units": [
                    _unit(unit, preview, states.get(f"unit/{unit}")) for unit, preview in enumerate(previews)
                ],
                "robots": [
                    {
                        "robot": robot,
                        "armed": _armed(states.get(f"robot/{robot}")),
                        "seen": _named(unit for unit, ids in enumerate(seen) if robot in ids),
                        "controlled": _named(unit for unit, ids in enumerate(owners) if robot in ids),
                        "state": _state(states.get(f"robot/{robot}")),
                    }
                    for robot in self._lab.ids
                ],
                "findings": [
                    {"level": finding.level.value, "text": finding.text}
                    for finding in self._findings(seen, owners)
                ],
                "lines": list(lines),
            }
        )

    def close(self) -> None:
        """Close the page, and remove the pictures."""
        if self._server is not None:
            self._server.close()
            shutil.rmtree(self._folder, ignore_errors=True)

    def _findings(self, seen: Sequence[set[int]], owners: Sequence[set[int]]) -> Iterator[Finding]:
        """Yield the results for all units together; robots without a unit count once some are controlled."""
        if set(self._lab.ids) <= set().union(*seen):
            yield Finding(Level.GOOD, "every robot is seen")
        yield from team_findings(self._lab, seen)
        lost = set(self._lab.ids).difference(*owners)
        if any(owners) and lost:
            yield Finding(Level.ADVICE, f"robots {_named(sorted(lost))} are controlled by no unit")


def _unit(unit: int, found: tuple[Preview, float] | None, process: ProcessState | None) -> dict[str, Any]:
    """Return the state of a unit for the page."""
    state = {"unit": unit, "state": _state(process), "age_s": None, "old": True, "text": "no picture yet"}
    if found is None:
        return state
    preview, age_s = found
    text = f"sees {len(preview.seen)}, controls {len(preview.controlled)}"
    if preview.sides_px:
        low, high = (f"{side:.0f}" for side in preview.sides_px)
        small = " (small)" if preview.sides_px[0] < GOOD_MARKER_PX else ""
        text += f"; markers {low if low == high else f'{low} to {high}'} px{small}"
    text += f"; {preview.trouble}" if preview.trouble else ""
    return {**state, "age_s": round(age_s, 1), "old": age_s > STALE_S, "text": text}


def _armed(process: ProcessState | None) -> str:
    if process is None or process.armed is None:
        return "?"
    return "ARMED" if process.armed else "no"


def _state(process: ProcessState | None) -> str:
    if process is None:
        return "on another machine"
    return process.state + (f" (start {process.starts})" if process.starts > 1 else "")


def _named(numbers: Iterator[int] | Sequence[int]) -> str:
    return ", ".join(map(str, numbers))
