"""Keys of study files, their meaning and allowed values."""

from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple, Self

from pydantic import Field, field_validator, model_validator

from skyherd.analysis.history import CURVES
from skyherd.analysis.summary_fields import GROUPS
from skyherd.datasets import (
    STUDY,
    Model,
    Name,
    built_in_names,
    check_tree,
    read_source,
    source_text,
)
from skyherd.errors import InputError, join_errors
from skyherd.study.parts import Parts, SweepModel, TaskModel
from skyherd.text import did_you_mean

CURVE = "history."
"""Prefix of fields of a run's history, which are arrays over time, beside those of its summary."""

REFERENCE = "reference"
"""Name of the reference sweep of a study of cameras."""

RUN_KEYS = ("perception", "control.rectify", "seed")
"""Grid keys of a study of cameras that are not camera parameters."""

INVARIANCE_KEEPS = ("goal_error_m", "shape_error", f"{CURVE}positions_m")
METHODS_KEEPS = (
    "reached_s",
    "ready_s",
    "simulated_s",
    "path_length_m",
    "min_gap_m",
    "collisions",
    "converged",
    "shape_error",
    f"{CURVE}affine_error",
    f"{CURVE}affine_reached_s",
    f"{CURVE}min_path_m",
    f"{CURVE}waypoints_m",
    f"{CURVE}messages_per_robot_s",
    f"{CURVE}numbers_per_robot_s",
)
"""Required fields of studies with pages of the kinds `invariance` and `methods`."""

SUMMARY_FIELDS = {field.key: field for group in GROUPS.values() for field in group if field.kind != "ids"}
"""Fields of the summary that a study can keep, by key."""


class FigureModel(Model):
    """A figure of the table: medians with ranges over the runs, or a dot per run where x is random."""

    name: Name = Field(description="of the PNG")
    title: str = ""
    x: str = Field(description="a parameter of the study")
    y: str = Field(description="a field that is kept")
    lines: str | None = Field(None, description="a parameter of the study, a line for each value")
    sweep: str | None = Field(None, description="the sweep whose runs are shown; by default all")
    x_label: str | None = Field(None, description="with the unit")
    y_label: str | None = Field(None, description="with the unit")
    lines_label: str | None = Field(None, description="with the unit")
    x_log: bool = False
    y_log: bool = False


class StudySpec(Parts):
    """A study: a scenario, its variations, and the stored values of each run."""

    description: str = Field("", description="purpose of the study")
    scenario: str = Field(description="a built-in scenario, or a TOML file beside the study")
    sweeps: list[SweepModel] = Field([], description="series of runs; if left out, the study is one")
    tasks_version: Annotated[int, Field(ge=1, lt=1000)] | None = Field(
        None, description="of the tasks: another number wherever a task changed, so that results can be cited"
    )
    tasks: list[TaskModel] = Field([], description="tasks that every sweep is run on")
    keep: list[str] = Field(
        min_length=1, description=f"fields of summary.json, or {CURVE}NAME for an array over time"
    )
    figures: list[FigureModel] = Field([], description="drawn of the table")
    pages: Literal["figures", "invariance", "methods"] = Field(
        "figures", description="kind of page made from the table"
    )
    quick: dict[str, Any] = Field({}, description="keys of the study that `skyherd study --quick` changes")

    @field_validator("keep")
    @classmethod
    def _kept(cls, keep: list[str]) -> list[str]:
        known = [*SUMMARY_FIELDS, *(f"{CURVE}{curve}" for curve in CURVES)]
        problems = [_unknown_field(name, known) for name in keep if name not in known]
        if problems:
            raise join_errors(problems)
        return list(dict.fromkeys(keep))

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        names = [sweep.name for sweep in self.sweeps]
        if len(set(names)) < len(names):
            raise InputError("sweeps", "two sweeps have one name", "each sweep its own name")
        self._check_tasks()
        problems = [
            problem.within_key(f"figures.{number}")
            for number, figure in enumerate(self.figures)
            for problem in self._figure_problems(figure, names)
        ]
        if problems:
            raise join_errors(problems)
        return self

    def _figure_problems(self, figure: FigureModel, sweeps: list[str]) -> Iterator[InputError]:
        varying = f"a key that varies: {', '.join(self.parameters) or 'this study has none'}"
        for place, key in (("x", figure.x), ("lines", figure.lines)):
            if key and key not in self.parameters:
                yield InputError(place, f"{key!r} does not vary", varying)
        if figure.y not in self.fields:
            yield InputError(
                "y", f"{figure.y!r} is not kept", f"one of {', '.join(self.fields)}, or add it to keep"
            )
        if figure.sweep is not None and figure.sweep not in sweeps:
            allowed = f"one of {', '.join(sweeps)}" if sweeps else "leave it out: the study has no sweeps"
            yield InputError("sweep", f"no sweep {figure.sweep!r}", allowed)

    @model_validator(mode="after")
    def _fit_for_invariance(self) -> Self:
        if self.pages != "invariance":
            return self
        needed = "which pages = 'invariance' needs"
        if missing := [name for name in INVARIANCE_KEEPS if name not in self.keep]:
            raise InputError("keep", f"lacks {', '.join(missing)}, {needed}", "add them")
        for sweep in self.all_sweeps:
            own = [key for key in sweep.grid if key not in RUN_KEYS]
            where = f"sweep {sweep.name!r}"
            if sweep.random or len(own) != (sweep.name != REFERENCE):
                raise InputError(where, "has not one parameter in its grid", f"exactly one, {needed}")
            if missing := [key for key in RUN_KEYS if key not in sweep.grid]:
                raise InputError(where, f"{missing[0]} is missing in the grid, {needed}", "add it")
        named = {sweep.name: sweep for sweep in self.sweeps}
        if REFERENCE not in named or "ideal" not in named[REFERENCE].over(self).grid["perception"]:
            what = f"no sweep {REFERENCE!r} with ideal perception, {needed}"
            raise InputError("sweeps", what, "add one, with other kinds of perception beside it")
        return self

    @model_validator(mode="after")
    def _fit_for_methods(self) -> Self:
        if self.pages != "methods":
            return self
        needed = "which pages = 'methods' needs"
        if missing := [name for name in METHODS_KEEPS if name not in self.keep]:
            raise InputError("keep", f"lacks {', '.join(missing)}, {needed}", "add them")
        if not self.sweeps:
            raise InputError("sweeps", "missing", f"a sweep for each method, {needed}")
        if not self.tasks:
            raise InputError("tasks", "missing", f"tasks and tasks_version, {needed}")
        return self

    def _check_tasks(self) -> None:
        """Check that tasks have unique names, keys of no sweep, and together a version."""
        names = [task.name for task in self.tasks]
        if len(set(names)) < len(names):
            raise InputError("tasks", "two tasks have one name", "each task its own name")
        if self.tasks and self.tasks_version is None:
            raise InputError("tasks_version", "missing", "a whole number, which tasks need")
        if self.tasks_version is not None and not self.tasks:
            raise InputError("tasks_version", "given without tasks", "leave it out, or add tasks")
        taken = {key for sweep in self.all_sweeps for key in sweep.keys}
        problems = [
            InputError(
                f"tasks.{number}.set", f"{key} is given by a sweep, or above it", "each key in one place"
            )
            for number, task in enumerate(self.tasks)
            for key in sorted(taken.intersection(task.set))
        ]
        if problems:
            raise join_errors(problems)

    @property
    def fields(self) -> list[str]:
        """Stored fields of the summary."""
        return [name for name in self.keep if not name.startswith(CURVE)]

    @property
    def curves(self) -> list[str]:
        """Stored fields of the history, without their prefix."""
        return [name.removeprefix(CURVE) for name in self.keep if name.startswith(CURVE)]

    @property
    def all_sweeps(self) -> list[SweepModel]:
        """Sweeps with the keys of the top added; one without a name if the study has none."""
        return [sweep.over(self) for sweep in self.sweeps or [SweepModel.model_construct(name="")]]

    @property
    def parameters(self) -> list[str]:
        """Return all keys that may differ between runs, in the order given."""
        own = [key for part in self.sweeps for key in part.keys]
        own += [key for task in self.tasks for key in task.set]
        drawn = self.random.draw if self.random else {}
        return list(dict.fromkeys([*self.grid, *drawn, *own]))

    @property
    def drawn(self) -> frozenset[str]:
        """Keys that are drawn at random in some sweep."""
        return frozenset(key for sweep in self.all_sweeps if sweep.random for key in sweep.random.draw)


class Study(NamedTuple):
    """A checked study: name, content, name in error messages, and its folder."""

    name: str
    spec: StudySpec
    where: str
    folder: Path


def study_names() -> list[str]:
    """List the names of the built-in studies."""
    return built_in_names(STUDY.package)


def study_text(name: str) -> str:
    """Return the TOML text of a built-in study; InputError if the name is unknown."""
    return source_text(name, STUDY)


def load_study(name_or_file: str, *, quick: bool = False) -> Study:
    """Read and check a built-in study or a TOML file, optionally with its table `quick` merged.

    Raises:
        InputError: a line for each problem: the file, the key, the value, and what is allowed.
    """
    source = read_source(name_or_file, STUDY)
    tree, where = source.tree, source.where
    if quick:
        if not isinstance(tree.get("quick"), dict):
            raise InputError(f"{where}: quick", "missing", "a table of the keys that a quick study changes")
        tree = _merge(tree, tree["quick"])
    spec = check_tree(StudySpec, tree, where, see=STUDY.schema)
    return Study(Path(name_or_file).stem if source.is_file else name_or_file, spec, where, source.folder)


def _unknown_field(name: str, known: list[str]) -> InputError:
    """Return the problem of an unknown field, with its present or a similar name."""
    new = name.replace("least_", "min_").replace("most_", "max_")
    if new in known:
        return InputError("", f"no field {name!r}", f"renamed to {new}")
    meant = did_you_mean(name, known)
    return InputError("", f"no field {name!r}", meant or f"one of {', '.join(known)}")


def _merge(under: dict[str, Any], over: dict[str, Any]) -> dict[str, Any]:
    """Merge two trees: tables are merged, other values are replaced."""
    merged = dict(under)
    for key, value in over.items():
        both = isinstance(value, dict) and isinstance(under.get(key), dict)
        merged[key] = _merge(under[key], value) if both else value
    return merged
