"""A handle in the scene that moves one robot on the ground or one unit in space."""

from dataclasses import dataclass
from threading import Lock
from typing import TYPE_CHECKING

import numpy as np

from skyherd.datasets import Mission
from skyherd.loop import Step
from skyherd.play.changes import Table
from skyherd.play.session import Change, Session

if TYPE_CHECKING:
    import viser

NAME = "/handle"
"""Name of the handle's node."""

NOTHING = "nothing"
"""Choice without a handle."""


@dataclass
class Held:
    """The handle at one object.

    Attributes:
        node: node of the handle.
        kind: `robot` or `unit`.
        number: id of the robot or number of the unit.
        is_dragged: True while a browser drags it.
    """

    node: "viser.TransformControlsHandle"
    kind: str
    number: int
    is_dragged: bool = False


class Grab:
    """Handle at the chosen robot or unit; it follows the object while it is not being dragged.

    Browsers choose and drag in threads of the server, and the drawing thread shows.

    Args:
        server: server of the page.
        session: session that is asked.
    """

    def __init__(self, server: "viser.ViserServer", session: Session) -> None:
        self._scene, self._session = server.scene, session
        mission = session.mission
        self._size_m = 3 * mission.scenario.marker.side_m
        self.choices = [
            NOTHING,
            *(f"robot {robot}" for robot in mission.ids.tolist()),
            *(f"unit {unit}" for unit in range(len(mission.scenario.units))),
        ]
        self._lock = Lock()
        self._held: Held | None = None

    def choose(self, choice: str) -> None:
        """Show the handle at `robot ID` or `unit NUMBER`, or hide it."""
        with self._lock:
            if self._held is not None:
                self._held.node.remove()
                self._held = None
            if choice == NOTHING:
                return
            kind, number = choice.split()
            is_unit = kind == "unit"
            node = self._scene.add_transform_controls(
                NAME,
                scale=self._size_m * (1.5 if is_unit else 1.0),
                active_axes=(True, True, is_unit),
                disable_rotations=True,
                depth_test=False,
                visible=False,
            )
            held = Held(node, kind, int(number))
            node.on_update(lambda event: self._drag(held, event.phase, node.position))
            self._held = held

    def show(self, step: Step, mission: Mission) -> None:
        """Put the handle at the place of its object."""
        with self._lock:
            held = self._held
            if held is None or held.is_dragged:
                return
            if held.kind == "unit":
                fleet = step.fleet
                place = [*fleet.positions_m[held.number], fleet.heights_m[held.number]]
            else:
                row = int(np.flatnonzero(mission.ids == held.number)[0])
                place = [*step.positions_m[row], 0.0]
            held.node.position = np.array(place, dtype=float)
            held.node.visible = True

    def _drag(self, held: Held, phase: str, position_m: np.ndarray) -> None:
        """Follow a drag, whose phase is `start`, `update` or `end`, and ask for the place of its object."""
        held.is_dragged = phase != "end"
        if phase == "update":
            x, y, z = (round(float(one), 3) for one in position_m)
            table: Table = {"kind": held.kind, held.kind: held.number, "position_m": [x, y]}
            self._session.ask(Change(({**table, "height_m": z} if held.kind == "unit" else table,)))
