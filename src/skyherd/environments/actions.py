"""Actions of agents: wheel commands of robots, or flight commands of aerial units.

Scaled actions are shares of the limits of wheels and autopilots, from -1 to 1. Others are in m/s, rad/s and
1/s without bounds, and the scenario's limits apply as always.
"""

from collections.abc import Mapping, Sequence
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt
from gymnasium.spaces import Box

from skyherd.datasets import Mission
from skyherd.errors import InputError
from skyherd.geometry import Array
from skyherd.loop import Overruling, Step
from skyherd.messages import FlightCommand, VelocityCommand
from skyherd.messages.checks import shown
from skyherd.sim.robot_teams import make_wheels

MAX_ZOOM_RATE_PS = 1.0
"""Zoom rate of the scaled action 1, 1/s. Chosen: a zoom by e in a second."""


class Actor(Protocol):
    """Interface of a kind of action.

    Attributes:
        agents: names of the agents.
        spaces: space of each agent.
    """

    agents: list[str]
    spaces: Sequence[Box]

    def overrule(self, actions: Mapping[str, npt.ArrayLike]) -> Overruling:
        """Return the commands of the actions of all agents.

        Raises:
            InputError: an action is missing, or is not one of the space's shape with finite numbers.
        """
        ...

    def references(self, step: Step, dead: Sequence[int]) -> list[Array]:
        """Return the actions of the paper's law at a step."""
        ...


class _Scale:
    """Conversion between actions and commands in SI units.

    Args:
        agents: names of the agents.
        limits: (A, K) commands of the scaled action 1.
        scaled: whether actions are scaled.
    """

    def __init__(self, agents: list[str], limits: Array, *, scaled: bool) -> None:
        self.agents, self.limits, self.scaled = agents, limits, scaled
        self.dtype: type[np.floating[Any]] = np.float32 if scaled else np.float64
        bound, shape = 1.0 if scaled else np.inf, limits.shape[1:]
        self.spaces: Sequence[Box] = [Box(-bound, bound, shape, self.dtype) for _ in agents]

    def commands(self, actions: Mapping[str, npt.ArrayLike]) -> Array:
        """Return the commands (A, K) of the agents' actions."""
        if missing := [agent for agent in self.agents if agent not in actions]:
            allowed = f"an action for each of {', '.join(self.agents)}"
            raise InputError("FormationEnv.step: actions", f"none for {', '.join(missing)}", allowed)
        taken = np.array([self._checked(agent, actions[agent]) for agent in self.agents])
        return np.clip(taken, -1.0, 1.0) * self.limits if self.scaled else taken

    def _checked(self, agent: str, action: npt.ArrayLike) -> Array:
        shape = self.limits.shape[1:]
        try:
            array = np.asarray(action, dtype=float)
        except (TypeError, ValueError):
            array = np.zeros(0)
        if array.shape != shape or not np.isfinite(array).all():
            raise InputError(
                f"FormationEnv.step: action of {agent}", shown(action), f"{shape[0]} finite numbers"
            )
        return array

    def actions(self, commands: Array) -> list[Array]:
        """Return the actions of the commands (A, K)."""
        rows = np.clip(commands / self.limits, -1.0, 1.0) if self.scaled else commands
        return list(rows.astype(self.dtype))


class WheelActions(Actor):
    """Forward speed v and turn rate ω of each robot; the units fly by their own law.

    Args:
        mission: the mission.
        scaled: whether actions are shares of the wheels' limits.
    """

    def __init__(self, mission: Mission, *, scaled: bool) -> None:
        wheels, self._ids = make_wheels(mission.scenario), mission.ids
        self.limits = np.array([wheels.max_speed_mps, wheels.max_turn_radps])
        self.agents = [f"robot_{robot}" for robot in mission.ids.tolist()]
        self._scale = _Scale(self.agents, np.tile(self.limits, (mission.ids.size, 1)), scaled=scaled)
        self.spaces = self._scale.spaces

    def overrule(self, actions: Mapping[str, npt.ArrayLike]) -> Overruling:
        """Return the wheel commands of the actions, within the limits of the wheels."""
        v_mps, omega_radps = np.clip(self._scale.commands(actions), -self.limits, self.limits).T
        return Overruling(wheels=VelocityCommand(self._ids, v_mps, omega_radps))

    def references(self, step: Step, dead: Sequence[int]) -> list[Array]:
        """Return the actions of the robots' own law, which follows the units' goals."""
        command = step.command
        return self._scale.actions(np.column_stack([command.v_mps, command.omega_radps]))


class FlightActions(Actor):
    """Flight of each unit: speed along +u and +v of its image, climb, yaw rate and zoom rate.

    Robots follow the units' goals. A failed unit hovers, whatever its action.

    Args:
        mission: the mission.
        scaled: whether actions are shares of the autopilots' limits, and of `MAX_ZOOM_RATE_PS`.
    """

    def __init__(self, mission: Mission, *, scaled: bool) -> None:
        limits, units = mission.scenario.autopilot, range(len(mission.scenario.units))
        self.agents = [f"unit_{unit}" for unit in units]
        self._max_speed_mps = limits.max_speed_mps
        row = [
            limits.max_speed_mps,
            limits.max_speed_mps,
            limits.max_climb_mps,
            np.radians(limits.max_yaw_rate_degps),
            MAX_ZOOM_RATE_PS,
        ]
        self._scale = _Scale(self.agents, np.tile(row, (len(units), 1)), scaled=scaled)
        self.spaces = self._scale.spaces
        self._flights = [FlightCommand.hold(unit) for unit in units]

    def overrule(self, actions: Mapping[str, npt.ArrayLike]) -> Overruling:
        """Return the flight commands of the actions."""
        rows = self._scale.commands(actions)
        flights = [
            FlightCommand(
                unit,
                row[:2],
                climb_mps=float(row[2]),
                yaw_rate_radps=float(row[3]),
                zoom_rate_ps=float(row[4]),
            )
            for unit, row in enumerate(rows)
        ]
        return Overruling(flights=flights)

    def references(self, step: Step, dead: Sequence[int]) -> list[Array]:
        """Return the actions of the units' flight law after their last images."""
        for unit, frame in step.frames.items():
            self._flights[unit] = frame.decision.flight
        for unit in dead:
            self._flights[unit] = FlightCommand.hold(unit)
        return self._scale.actions(np.array([self._row(flight) for flight in self._flights]))

    def _row(self, flight: FlightCommand) -> list[float]:
        lateral_mps = flight.lateral_mps
        if self._scale.scaled:  # The autopilot keeps the direction of a velocity that it limits.
            speed_mps = float(np.linalg.norm(lateral_mps))
            lateral_mps = lateral_mps * (self._max_speed_mps / max(speed_mps, self._max_speed_mps))
        return [*lateral_mps.tolist(), flight.climb_mps, flight.yaw_rate_radps, flight.zoom_rate_ps]


ACTORS: dict[str, type[WheelActions] | type[FlightActions]] = {
    "wheels": WheelActions,
    "flight": FlightActions,
}
"""Kinds of actions by name."""
