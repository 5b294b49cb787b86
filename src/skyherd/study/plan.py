"""A study's runs: what each is given, and the key under which its outcome is kept."""

import hashlib
import json
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
from skyherd.study.spec import DrawModel, RandomModel, Study, SweepModel
from skyherd.version import __version__

Settings = dict[str, Any]
SHOWN_VALUE = 40


@dataclass(frozen=True)
class Run:
    """One run of a study.

    Attributes:
        sweep: the sweep it belongs to.
        settings: what is put over the scenario, by dotted key.
        parameters: the scenario's values at all keys that vary in the study.
        key: hash of all that its outcome follows from.
    """

    sweep: str
    settings: Settings
    parameters: Settings
    key: str

    def text(self) -> str:
        """What makes it differ from the others, in a line."""
        values = ", ".join(f"{key}={_short(value)}" for key, value in self.parameters.items())
        return f"{self.sweep}: {values}" if self.sweep else values or "as the scenario has it"


@dataclass(frozen=True)
class Plan:
    """All runs of a study, in its order: sweep by sweep, draw by draw, the last key of the grid fastest."""

    study: Study
    source: ScenarioSource
    runs: list[Run]

    def mission(self, run: Run) -> Mission:
        """The mission of one of its runs."""
        return _mission(self.source, run.settings, self.study.where)


def make_plan(study: Study) -> Plan:
    """Check every run of a study, as its scenario would be checked.

    Raises:
        InputError: in one line, the file, the key, the value, and what is allowed.
    """
    source = _source(study)
    runs = []
    for sweep in study.spec.all_sweeps:
        for settings in sweep_settings(sweep):
            named = ", ".join(f"{key}={_short(settings[key])}" for key in settings if key not in sweep.set)
            where = ": ".join(filter(None, (study.where, sweep.name, named)))
            mission = _mission(source, settings, where)
            dump = mission.scenario.model_dump(mode="json")
            values = {key: _value(dump, key) for key in study.spec.parameters}
            runs.append(Run(sweep.name, settings, values, mission_key(mission)))
    return Plan(study, source, runs)


def mission_key(mission: Mission) -> str:
    """Hash of all that a run follows from: the scenario, what its pictures say, and skyherd's version.

    Where pictures lie and what a scenario says about itself do not count.
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
    """What a sweep puts over the scenario, run by run; the same draws at every point of the grid."""
    count = sweep.random.runs if sweep.random else 1
    for number in range(count):
        drawn = draw_settings(sweep.random, number) if sweep.random else {}
        for values in product(*sweep.grid.values()):
            yield {**sweep.set, **drawn, **dict(zip(sweep.grid, values, strict=True))}


def draw_settings(random: RandomModel, number: int) -> Settings:
    """Draw so many of each key. A stream of its own for each: more runs or keys change none of the others."""

    def stream(key: str) -> np.random.Generator:
        word = int.from_bytes(hashlib.sha256(key.encode()).digest()[:8])
        return np.random.default_rng([random.seed, number, word])

    return {key: draw_value(model, stream(key)) for key, model in random.draw.items()}


def draw_value(model: DrawModel, rng: np.random.Generator) -> Any:
    """One value."""
    if model.choice is not None:
        return model.choice[draw_integer(rng, (0, len(model.choice) - 1))]
    if model.whole is not None:
        return draw_integer(rng, model.whole)
    if model.log is not None:
        return float(np.exp(draw_number(rng, (np.log(model.log[0]), np.log(model.log[1])))))
    if model.uniform is None:
        raise ValueError("a draw has exactly one kind")
    return draw_number(rng, model.uniform)


def _source(study: Study) -> ScenarioSource:
    name = study.spec.scenario
    beside = study.folder / name
    try:
        return read_scenario(str(beside) if name.endswith(".toml") or beside.is_file() else name)
    except InputError as error:
        raise InputError(f"{study.where}: scenario: {error.where}", error.what, error.allowed) from None


def _mission(source: ScenarioSource, settings: Settings, where: str) -> Mission:
    tree = deepcopy(source.tree)
    for key, value in settings.items():
        put_value(tree, key, value, f"{where}: {key}")
    return make_mission(tree, where=where, folder=source.folder)


def _value(dump: dict[str, Any], key: str) -> Any:
    """A value of a checked scenario; None where another sweep's key leads nowhere in this one."""
    try:
        return get_value(dump, key)
    except (KeyError, IndexError, TypeError, ValueError):
        return None


def _pairs(points: np.ndarray) -> list[list[float]]:
    return [[point.real, point.imag] for point in points.tolist()]


def _short(value: Any) -> str:
    """A value in few letters."""
    text = f"{value:.6g}" if isinstance(value, float) else str(value)
    return text if len(text) <= SHOWN_VALUE else f"{text[: SHOWN_VALUE - 1]}…"
