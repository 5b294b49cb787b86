"""Runs of a study: settings of each, and the key under which its outcome is kept."""

import hashlib
import json
import math
from collections.abc import Iterator
from copy import deepcopy
from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np

from skyherd.datasets import (
    Mission,
    ScenarioSource,
    draw_integer,
    draw_number,
    get_value,
    make_mission,
    put_value,
    read_scenario,
)
from skyherd.errors import InputError
from skyherd.files.reading import is_regular
from skyherd.study.parts import DrawModel, RandomModel, SweepModel, TaskModel
from skyherd.study.spec import Study
from skyherd.version import __version__

Settings = dict[str, Any]
"""Values that replace those of a scenario, by dotted key."""

MAX_RUNS = 1_000_000
"""Maximum number of runs of a study, in all its sweeps. *Chosen*: a day's work for a large cluster; a grid of
twenty keys with three values each has three thousand times as many."""

NO_TASK = TaskModel.model_construct(name="", about="", set={})
"""Task of a study without tasks: the unchanged scenario."""

SHOWN_VALUE = 40
"""Maximum length of a shown value, characters."""


@dataclass(frozen=True)
class Run:
    """One run of a study.

    Attributes:
        sweep: the sweep it belongs to.
        task: its task; empty if the study has none.
        settings: values that replace those of the scenario, by dotted key.
        parameters: the scenario's values at all keys that vary in the study.
        key: hash of everything that its outcome depends on.
    """

    sweep: str
    task: str
    settings: Settings
    parameters: Settings
    key: str

    def text(self) -> str:
        """Return the distinguishing settings of the run in one line."""
        values = ", ".join(f"{key}={_short(value)}" for key, value in self.parameters.items())
        return ": ".join(filter(None, (self.sweep, self.task, values))) or "the scenario without changes"


@dataclass(frozen=True)
class Plan:
    """All runs of a study: sweep by sweep, task by task, draw by draw, the last key of the grid fastest."""

    study: Study
    source: ScenarioSource
    runs: list[Run]

    def mission(self, run: Run) -> Mission:
        """Make the mission of one of the plan's runs."""
        return _mission(self.source, run.settings, self.study.where)


def make_plan(study: Study) -> Plan:
    """List the runs of a study, each checked as its own scenario.

    Raises:
        InputError: in one line, the file, the key, the value, and what is allowed.
    """
    source = study_source(study)
    _check_count(study)
    runs = []
    for sweep, task in product(study.spec.all_sweeps, study.spec.tasks or [NO_TASK]):
        for own in sweep_settings(sweep):
            settings = {**own, **task.set}
            named = ", ".join(f"{key}={_short(settings[key])}" for key in own if key not in sweep.set)
            where = ": ".join(filter(None, (study.where, sweep.name, task.name, named)))
            mission = _mission(source, settings, where)
            dump = mission.scenario.model_dump(mode="json")
            values = {key: _value(dump, key) for key in study.spec.parameters}
            runs.append(Run(sweep.name, task.name, settings, values, mission_key(mission)))
    return Plan(study, source, runs)


def _check_count(study: Study) -> None:
    """Reject more than `MAX_RUNS`: a short grid may have too many points to enumerate.

    Raises:
        InputError: the study has too many runs.
    """
    count = max(1, len(study.spec.tasks)) * sum(
        (sweep.random.runs if sweep.random else 1) * math.prod(map(len, sweep.grid.values()))
        for sweep in study.spec.all_sweeps
    )
    if count > MAX_RUNS:
        raise InputError(study.where, f"{count:.3g} runs", f"at most {MAX_RUNS}; fewer values in the grid")


def mission_key(mission: Mission) -> str:
    """Return a hash, 32 hexadecimal digits, of everything that a run depends on.

    This covers the scenario, the content of its pictures, and skyherd's version. The paths of the pictures
    and the scenario's description do not count. Equal runs of different studies have the same key.
    """
    scenario = mission.scenario.model_dump(mode="json")
    scenario["description"] = scenario["template"]["image"] = scenario["ground"]["image"] = None
    ground = mission.ground_image
    record = {
        "skyherd": __version__,
        "scenario": scenario,
        "template": [mission.template.ids.tolist(), _pairs(mission.template.points_px)],
        "later": [[at_s, _pairs(shape.points_px)] for at_s, shape in mission.later],
        "start": [mission.ids.tolist(), mission.positions_m.tolist(), mission.headings_rad.tolist()],
        "ground": None if ground is None else [ground.shape, hashlib.sha256(ground.tobytes()).hexdigest()],
    }
    return hashlib.sha256(json.dumps(record, sort_keys=True).encode()).hexdigest()[:32]


def sweep_settings(sweep: SweepModel) -> Iterator[Settings]:
    """Yield the settings of a sweep run by run; every grid point has the same random draws."""
    count = sweep.random.runs if sweep.random else 1
    for number in range(count):
        drawn = draw_settings(sweep.random, number) if sweep.random else {}
        for values in product(*sweep.grid.values()):
            yield {**sweep.set, **drawn, **dict(zip(sweep.grid, values, strict=True))}


def draw_settings(random: RandomModel, number: int) -> Settings:
    """Draw number `number` of every key at random.

    Each key has its own random stream, so that further runs or keys do not change the other draws.
    """

    def stream(key: str) -> np.random.Generator:
        key_hash = int.from_bytes(hashlib.sha256(key.encode()).digest()[:8])
        return np.random.default_rng([random.seed, number, key_hash])

    return {key: draw_value(model, stream(key)) for key, model in random.draw.items()}


def draw_value(model: DrawModel, rng: np.random.Generator) -> Any:
    """Draw one value of a parameter from its distribution."""
    if model.choice is not None:
        return model.choice[draw_integer(rng, (0, len(model.choice) - 1))]
    if model.whole is not None:
        return draw_integer(rng, model.whole)
    if model.log is not None:
        return float(np.exp(draw_number(rng, (np.log(model.log[0]), np.log(model.log[1])))))
    if model.uniform is None:
        raise ValueError("a draw has exactly one kind")
    return draw_number(rng, model.uniform)


def study_source(study: Study) -> ScenarioSource:
    """Return the scenario of a study, beside its file or built in; InputError if missing or invalid."""
    name = study.spec.scenario
    beside = study.folder / name
    try:
        return read_scenario(str(beside) if name.endswith(".toml") or is_regular(beside) else name)
    except InputError as error:
        raise error.within(f"{study.where}: scenario") from None


def _mission(source: ScenarioSource, settings: Settings, where: str) -> Mission:
    tree = deepcopy(source.tree)
    for key, value in settings.items():
        put_value(tree, key, value, f"{where}: {key}")
    return make_mission(tree, where=where, folder=source.folder)


def _value(dump: dict[str, Any], key: str) -> Any:
    """Return a value of a checked scenario; None if the key belongs to another sweep."""
    try:
        return get_value(dump, key)
    except (KeyError, IndexError, TypeError, ValueError):
        return None


def _pairs(points: np.ndarray) -> list[list[float]]:
    return [[point.real, point.imag] for point in points.tolist()]


def _short(value: Any) -> str:
    """Return a value as text of at most `SHOWN_VALUE` characters."""
    text = f"{value:.6g}" if isinstance(value, float) else str(value)
    return text if len(text) <= SHOWN_VALUE else f"{text[: SHOWN_VALUE - 1]}…"
