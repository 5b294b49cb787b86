"""A handle in the scene that moves one robot on the ground or one unit in space."""

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


class Grab:
    """Handle at the chosen robot or unit; it follows the object while it is not being dragged.

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
        self._choice, self._is_held = NOTHING, False
        self._node: viser.TransformControlsHandle | None = None

    def choose(self, choice: str) -> None:
        """Show the handle at `robot ID` or `unit NUMBER`, or hide it."""
        if self._node is not None:
            self._node.remove()
            self._node = None
        self._choice, self._is_held = choice, False
        if choice == NOTHING:
            return
        is_unit = choice.startswith("unit")
        node = self._scene.add_transform_controls(
            NAME,
            scale=self._size_m * (1.5 if is_unit else 1.0),
            active_axes=(True, True, is_unit),
            disable_rotations=True,
            depth_test=False,
            visible=False,
        )
        node.on_update(lambda event: self._drag(event.phase, node.position))
        self._node = node

    def show(self, step: Step, mission: Mission) -> None:
        """Put the handle at the place of its object."""
        node = self._node
        if node is None or self._is_held:
            return
        kind, number = self._choice.split()
        if kind == "unit":
            place = [*step.fleet.positions_m[int(number)], step.fleet.heights_m[int(number)]]
        else:
            row = int(np.flatnonzero(mission.ids == int(number))[0])
            place = [*step.positions_m[row], 0.0]
        node.position = np.array(place, dtype=float)
        node.visible = True

    def _drag(self, phase: str, position_m: np.ndarray) -> None:
        """Follow a drag, whose phase is `start`, `update` or `end`, and ask for the place of its object."""
        self._is_held = phase != "end"
        if phase == "update":
            x, y, z = (round(float(one), 3) for one in position_m)
            kind, number = self._choice.split()
            table: Table = {"kind": kind, kind: int(number), "position_m": [x, y]}
            self._session.ask(Change(({**table, "height_m": z} if kind == "unit" else table,)))
