"""`FormationEnv`: a scenario as an environment with the interface of PettingZoo."""

from collections.abc import Generator, Iterable, Mapping
from copy import deepcopy
from dataclasses import replace
from time import perf_counter
from typing import Any

import numpy as np
import numpy.typing as npt
from gymnasium.spaces import Box, Space
from pettingzoo import ParallelEnv

from skyherd.analysis.history import make_history
from skyherd.analysis.summary import summarize
from skyherd.control import GoalFollowers, RobotTeam
from skyherd.datasets import Mission, apply_settings, make_mission, read_scenario
from skyherd.datasets.random_streams import RunStream, generator
from skyherd.environments.actions import ACTORS, Actor
from skyherd.environments.knowledge import Cast, Knowledge
from skyherd.environments.observations import ObservationOptions, Observer, make_observer
from skyherd.environments.pictures import GROUND, Picture, make_picture
from skyherd.environments.rewards import Rewards, Transition, WeightedRewards
from skyherd.errors import InputError
from skyherd.geometry import RgbImage
from skyherd.loop import Overruling, Step, run_steps
from skyherd.messages import TIME_TOLERANCE_S, VelocityCommand
from skyherd.messages.checks import check_count, check_flags, check_kind, shown
from skyherd.sim.robot_teams import make_team, make_wheels
from skyherd.sim.world import World
from skyherd.text import one_of

Settings = Iterable[str] | Mapping[str, object]
"""Settings of a scenario, as `load_mission` takes them."""

MAX_BODIES = 64
"""Maximum number of bodies in an observation. Chosen: the robots of the largest random missions."""

MAX_IMAGE_PX = 4096
"""Maximum width and height of images in observations. Chosen: larger than the cameras of the scenarios."""

SEEDS = 2**31
"""Number of seeds of episodes that are drawn. Chosen: fits everywhere."""

OBSERVATIONS = ("vectors", "detections", "images")
"""Kinds of observations."""

Result = tuple[dict[str, Any], dict[str, float], dict[str, bool], dict[str, bool], dict[str, dict[str, Any]]]
"""Observations, rewards, terminations, truncations and infos by agent."""


class FormationEnv(ParallelEnv[str, Any, npt.NDArray[Any]]):  # type: ignore[misc]  # has no types
    """Environment of a scenario: agents are its robots (`wheels`) or its aerial units (`flight`).

    One step is one step of the scenario. Observations come from images and messages alone. `infos` has for
    each agent `reference_action`, the action of the paper's law; `seed` of the episode; and the true
    `time_s`, `shape_error` and `is_held`.

    Agents are truncated at the end of the scenario's duration. An episode with a seed is the run of
    `skyherd run` with that seed, as long as the actions are those of the paper's law.

    With wheel actions `control.camera_check` is off, since robots need not follow the units' goals.

    Attributes:
        possible_agents: names of all agents, such as `robot_3` or `unit_0`.
        agents: agents of the present episode; empty before `reset` and at its end.
        metadata: name, render modes and frames per second.
        state_space: space of `state`.

    Args:
        scenario: name of a built-in scenario, or a TOML file.
        settings: settings of the scenario, as `load_mission` takes them.
        observations: `vectors`, `detections` or `images`; `skyherd.environments.observations` describes them.
        actions: `wheels` or `flight`; `skyherd.environments.actions` describes them.
        rewards: name of a built-in reward, a function of a `Transition`, or weights by name or function.
        bodies: number of nearest bodies in the vector of a robot.
        image_size_px: width and height to which images are resized; those of the cameras if None.
        scaled: whether actions are from -1 to 1, as shares of limits (float32); otherwise SI units (float64).
        terminate_when_held: whether an episode ends when the shape error stayed under its goal for
            `goal.hold_s`.
        keep_steps: whether to keep the steps of the episode for `summary`.
        render_mode: `rgb_array`, or None without pictures.
        view: picture of `render`: `ground` or the name of a unit.

    Raises:
        InputError: an argument, the scenario or a setting is invalid.
    """

    metadata: dict[str, Any]

    def __init__(
        self,
        scenario: str,
        settings: Settings = (),
        *,
        observations: str = "vectors",
        actions: str = "wheels",
        rewards: Rewards = "shape",
        bodies: int = 4,
        image_size_px: tuple[int, int] | None = None,
        scaled: bool = True,
        terminate_when_held: bool = False,
        keep_steps: bool = False,
        render_mode: str | None = None,
        view: str = GROUND,
    ) -> None:
        _check_choice("observations", observations, OBSERVATIONS)
        _check_choice("actions", actions, tuple(ACTORS))
        if render_mode is not None:
            _check_choice("render_mode", render_mode, ("rgb_array",))
        check_count("FormationEnv: bodies", bodies, most=MAX_BODIES)
        where = "FormationEnv"
        check_flags(where, scaled=scaled, terminate_when_held=terminate_when_held, keep_steps=keep_steps)
        self._source = read_scenario(scenario)
        self._settings = settings if isinstance(settings, Mapping) else list(settings)
        self._kind, self._scaled, self._ends_when_held = actions, scaled, terminate_when_held
        self._options = ObservationOptions(observations, bodies, _checked_size(image_size_px))
        self._rewards = WeightedRewards(rewards)
        self.render_mode, self._view = render_mode, view
        self._kept: list[Step] | None = [] if keep_steps else None
        self._mission = self._make_mission(None, {})
        self._next_seed: int = self._mission.scenario.seed
        self._seeds = generator(self._next_seed, RunStream.EPISODES)
        self._actor: Actor = ACTORS[actions](self._mission, scaled=scaled)
        self._cast = Cast.of(self._mission)
        self._observer = self._make_observer(self._mission)
        if render_mode:
            make_picture(self._mission, view)
        self.possible_agents, self.agents = list(self._actor.agents), list[str]()
        self._action_spaces = dict(zip(self.possible_agents, self._actor.spaces, strict=True))
        self._observation_spaces = dict(zip(self.possible_agents, self._observer.spaces, strict=True))
        robots, units = self._mission.ids.size, len(self._mission.scenario.units)
        self.state_space = Box(-np.inf, np.inf, (1 + 4 * robots + 8 * units,), np.float32)
        self.metadata = {
            "name": "skyherd_formation_v0",
            "render_modes": ["rgb_array"],
            "render_fps": 1 / self._mission.scenario.step_s,
            "is_parallelizable": True,
        }
        self._steps: Generator[Step, Overruling | None, None] | None = None
        self._picture: Picture | None = None
        self._step: Step
        self._known: Knowledge
        self._formed_s: float | None
        self._seed: int
        self._began_s = self._wall_s = 0.0

    def observation_space(self, agent: str) -> Space[Any]:
        """Return the observation space of an agent, always the same object."""
        return self._observation_spaces[agent]

    def action_space(self, agent: str) -> Space[Any]:
        """Return the action space of an agent, always the same object."""
        return self._action_spaces[agent]

    def reset(
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Any], dict[str, dict[str, Any]]]:
        """Begin an episode, and return observations and infos by agent.

        Args:
            seed: seed of the scenario. Without one, the first episode has the scenario's own seed, and later
                ones have seeds drawn from the last given one.
            options: `settings` are further settings of the scenario for this episode, as a mapping. Other
                keys are ignored.

        Raises:
            InputError: the seed or a setting is invalid, or changes the number of agents or a space.
        """
        if seed is not None:
            check_count("FormationEnv.reset: seed", seed, most=2**63 - 1)
            self._next_seed, self._seeds = int(seed), generator(int(seed), RunStream.EPISODES)
        extra = (options or {}).get("settings", {})
        check_kind("FormationEnv.reset: options['settings']", extra, Mapping, "a mapping of values by key")
        mission = self._make_mission(self._next_seed, extra)
        self._check_spaces(mission)
        self.close()
        self._seed, self._next_seed = self._next_seed, int(self._seeds.integers(SEEDS))
        self._mission, self._formed_s, self._began_s = mission, None, perf_counter()
        self._actor = ACTORS[self._kind](mission, scaled=self._scaled)
        self._cast = Cast.of(mission)
        self._picture = make_picture(mission, self._view) if self.render_mode else None
        self._steps = run_steps(mission, team_for=self._make_team)
        self.agents = list(self.possible_agents)
        self._take(next(self._steps))
        return self._observations(), self._infos()

    def step(self, actions: dict[str, npt.ArrayLike]) -> Result:
        """Move the world by one step under the agents' actions.

        Args:
            actions: action of each agent.

        Returns:
            Observations, rewards, terminations, truncations and infos by agent.

        Raises:
            InputError: there is no episode, an action is missing or invalid, or a reward is not finite.
        """
        if self._steps is None or not self.agents:
            raise InputError("FormationEnv.step", "no episode, or a finished one", "reset() before step()")
        overruling = self._actor.overrule(actions)
        command = overruling.wheels or self._step.command
        self._known.team.record(command, self._step.time_s)
        self._known.rates = self._shares(command)
        before = replace(self._step, command=command)
        if self._kept is not None:
            self._kept[-1] = before.without_images()
        self._take(self._steps.send(overruling))
        rewards = self._rewards.of(Transition(self._mission, before, self._step), len(self.agents))
        acted = self.agents
        terminated = self._ends_when_held and self._is_held
        truncated = self._step.time_s >= self._last_s - TIME_TOLERANCE_S
        observations, infos = self._observations(), self._infos()
        if terminated or truncated:
            self.agents, self._wall_s = [], perf_counter() - self._began_s
        return (
            observations,
            dict(zip(acted, rewards.tolist(), strict=True)),
            dict.fromkeys(acted, terminated),
            dict.fromkeys(acted, truncated),
            infos,
        )

    def state(self) -> npt.NDArray[np.float32]:
        """Return the true state of all robots and units, for centralised training.

        It is the share of the duration that has passed; x, y, m, and cosine and sine of the heading of each
        robot; and x, y, height, m, cosine and sine of the yaw, both tilts, rad, and the zoom of each unit.

        Raises:
            InputError: there is no episode.
        """
        step, fleet = self._present("state"), self._present("state").fleet
        robots = np.column_stack([step.positions_m, np.cos(step.headings_rad), np.sin(step.headings_rad)])
        units = np.column_stack(
            [
                fleet.positions_m,
                fleet.heights_m,
                np.cos(fleet.yaws_rad),
                np.sin(fleet.yaws_rad),
                fleet.tilts_rad,
                fleet.zooms,
            ]
        )
        share = step.time_s / self._mission.scenario.duration_s
        return np.concatenate([[share], robots.ravel(), units.ravel()]).astype(np.float32)

    def render(self) -> RgbImage:
        """Return the picture of the present step, (height, width, 3) `uint8`.

        Raises:
            InputError: there is no episode, or no render mode.
        """
        self._present("render")
        if self._picture is None:
            raise InputError("FormationEnv.render", "no render mode", "render_mode='rgb_array'")
        return self._picture.image

    def summary(self) -> dict[str, Any]:
        """Return the summary of the episode so far, with the keys of `summary.json`.

        Raises:
            InputError: there is no episode, or the environment keeps no steps.
        """
        self._present("summary")
        if self._kept is None:
            raise InputError("FormationEnv.summary", "no steps are kept", "keep_steps=True")
        return summarize(make_history(self._mission, self._kept), None if self.agents else self._wall_s)

    def close(self) -> None:
        """End the episode and release its world."""
        if self._steps is not None:
            self._steps.close()
        self._steps, self._picture, self.agents = None, None, []
        if self._kept is not None:
            self._kept = []

    def _make_mission(self, seed: int | None, extra: Mapping[str, object]) -> Mission:
        """Return the mission of a seed, the scenario's own if None, with further settings.

        Raises:
            InputError: the scenario or a setting is invalid, or robots follow another law.
        """
        tree, origins = deepcopy(self._source.tree), dict[str, str]()
        for settings in (self._settings, extra):
            origins |= apply_settings(tree, settings, "control.k=0.2", "skyherd scenario schema")
        if seed is not None:
            tree["seed"] = seed
        if self._kind == "wheels" and isinstance(tree.setdefault("control", {}), dict):
            tree["control"]["camera_check"] = False
        where, folder = self._source.where, self._source.folder
        mission = make_mission(tree, where=where, folder=folder, origins=origins)
        method = mission.scenario.control.method
        if method != "similarity":
            raise InputError("control.method", method, "similarity, the law that follows the units' goals")
        return mission

    def _make_observer(self, mission: Mission) -> Observer:
        return make_observer(Cast.of(mission), self._options, self._kind, mission.scenario.perception)

    def _check_spaces(self, mission: Mission) -> None:
        """Check that a mission has the agents and spaces of this environment.

        Raises:
            InputError: it has others.
        """
        agents, observer = (
            ACTORS[self._kind](mission, scaled=self._scaled).agents,
            self._make_observer(mission),
        )
        if agents != self.possible_agents or list(observer.spaces) != list(self._observer.spaces):
            allowed = "settings that keep robots, units, obstacles, image sizes and avoidance.on"
            raise InputError(
                "FormationEnv.reset: options['settings']", "they change agents or spaces", allowed
            )

    def _make_team(self, mission: Mission, world: World) -> RobotTeam:
        """Make the robots, whose memory of messages the agents know."""
        team = make_team(mission, world)
        if not isinstance(team, GoalFollowers):
            raise TypeError("robots with the method similarity are GoalFollowers")
        self._known = Knowledge(team, np.zeros((mission.ids.size, 2)))
        return team

    def _shares(self, command: VelocityCommand) -> npt.NDArray[np.float64]:
        """Return v and ω (N, 2) of a command as shares of the limits of the wheels."""
        wheels = make_wheels(self._mission.scenario)
        return np.column_stack(
            [command.v_mps / wheels.max_speed_mps, command.omega_radps / wheels.max_turn_radps]
        )

    def _take(self, step: Step) -> None:
        """Take in the next step."""
        self._step = step
        self._known.update(step, self._mission.scenario.dead_units(step.time_s))
        if self._kept is not None:
            self._kept.append(step.without_images())
        if self._picture is not None:
            self._picture.draw(step)
        formed = step.metrics.shape.error < self._mission.scenario.goal.shape_error
        if not formed:
            self._formed_s = None
        elif self._formed_s is None:
            self._formed_s = step.time_s

    @property
    def _last_s(self) -> float:
        """Time of the last step, s."""
        scenario = self._mission.scenario
        return round(scenario.duration_s / scenario.step_s) * scenario.step_s

    @property
    def _is_held(self) -> bool:
        """True if the shape error stayed under its goal for the hold time."""
        held_s = self._mission.scenario.goal.hold_s - TIME_TOLERANCE_S
        return self._formed_s is not None and self._step.time_s - self._formed_s >= held_s

    def _observations(self) -> dict[str, Any]:
        return dict(zip(self.agents, self._observer.observe(self._known), strict=True))

    def _infos(self) -> dict[str, dict[str, Any]]:
        step = self._step
        references = self._actor.references(step, self._mission.scenario.dead_units(step.time_s))
        common = {
            "seed": self._seed,
            "time_s": step.time_s,
            "shape_error": step.metrics.shape.error,
            "is_held": self._is_held,
        }
        return {
            agent: {"reference_action": reference, **common}
            for agent, reference in zip(self.agents, references, strict=True)
        }

    def _present(self, call: str) -> Step:
        """Return the present step. Before the first reset, raise an error."""
        if self._steps is None:
            raise InputError(f"FormationEnv.{call}", "no episode", "reset() first")
        return self._step


def _check_choice(name: str, value: object, choices: tuple[str, ...]) -> None:
    if value not in choices:
        raise InputError(f"FormationEnv: {name}", shown(value), one_of(str(value), choices))


def _checked_size(size_px: Any) -> tuple[int, int] | None:
    """Return an image size as two integers.

    Raises:
        InputError: it is no width and height.
    """
    if size_px is None:
        return None
    sides = list(size_px) if isinstance(size_px, Iterable) else []
    allowed = f"a width and a height from 1 to {MAX_IMAGE_PX}, or None"
    if len(sides) != 2 or not all(isinstance(n, int | np.integer) and 1 <= n <= MAX_IMAGE_PX for n in sides):
        raise InputError("FormationEnv: image_size_px", shown(size_px), allowed)
    return int(sides[0]), int(sides[1])
