"""Keys of study files, their meaning and allowed values."""

from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple, Self

from pydantic import Field, ValidationError, field_validator, model_validator

from skyherd.analysis.history import CURVES
from skyherd.analysis.summary_fields import GROUPS
from skyherd.datasets import Model, built_in_names, built_in_text, first_error, parse_toml, read_toml_text
from skyherd.errors import InputError
from skyherd.files.reading import is_regular
from skyherd.study.parts import Parts, SweepModel, TaskModel

BUILT_IN = "skyherd.study.specs"
"""Package of the built-in studies' TOML files."""

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

    name: str = Field(pattern=r"^\w[\w-]*$", description="of the PNG")
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

    description: str = Field("", description="what it is for")
    scenario: str = Field(description="a built-in scenario, or a TOML file beside the study")
    sweeps: list[SweepModel] = Field([], description="series of runs; if left out, the study is one")
    tasks_version: Annotated[int, Field(ge=1, lt=1000)] | None = Field(
        None, description="of the tasks: another number wherever a task changed, so that results can be cited"
    )
    tasks: list[TaskModel] = Field([], description="what every sweep is run on")
    keep: list[str] = Field(
        min_length=1, description=f"fields of summary.json, or {CURVE}NAME for an array over time"
    )
    figures: list[FigureModel] = Field([], description="drawn of the table")
    pages: Literal["figures", "invariance", "methods"] = Field(
        "figures", description="what is made of the table"
    )
    quick: dict[str, Any] = Field({}, description="keys of the study that --quick changes")

    @field_validator("keep")
    @classmethod
    def _kept(cls, keep: list[str]) -> list[str]:
        for name in keep:
            if name not in SUMMARY_FIELDS and name.removeprefix(CURVE) not in CURVES:
                curves = ", ".join(f"{CURVE}{curve}" for curve in CURVES)
                raise ValueError(f"no field {name!r}; one of {', '.join(SUMMARY_FIELDS)}, {curves}")
        return list(dict.fromkeys(keep))

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        names = [sweep.name for sweep in self.sweeps]
        if len(set(names)) < len(names):
            raise ValueError("sweeps: give each its own name")
        self._check_tasks()
        varying = f"what does: {', '.join(self.parameters) or 'nothing'}"
        for figure in self.figures:
            for key in filter(None, (figure.x, figure.lines)):
                if key not in self.parameters:
                    raise ValueError(f"figure {figure.name}: {key!r} does not vary; {varying}")
            if figure.y not in self.fields:
                raise ValueError(f"figure {figure.name}: {figure.y!r} is not kept; see keep")
            if figure.sweep is not None and figure.sweep not in names:
                raise ValueError(f"figure {figure.name}: no sweep {figure.sweep!r}; {', '.join(names)}")
        return self

    @model_validator(mode="after")
    def _fit_for_invariance(self) -> Self:
        if self.pages != "invariance":
            return self
        if missing := [name for name in INVARIANCE_KEEPS if name not in self.keep]:
            raise ValueError(f"keep: pages of invariance need {', '.join(missing)} too")
        for sweep in self.all_sweeps:
            own = [key for key in sweep.grid if key not in RUN_KEYS]
            if sweep.random or len(own) != (sweep.name != REFERENCE):
                raise ValueError(f"sweep {sweep.name!r}: pages of invariance need one parameter in its grid")
            if missing := [key for key in RUN_KEYS if key not in sweep.grid]:
                raise ValueError(f"sweep {sweep.name!r}: pages of invariance need {missing[0]} in the grid")
        named = {sweep.name: sweep for sweep in self.sweeps}
        if REFERENCE not in named or "ideal" not in named[REFERENCE].over(self).grid["perception"]:
            raise ValueError(f"pages of invariance need a sweep {REFERENCE!r}, ideal perception among others")
        return self

    @model_validator(mode="after")
    def _fit_for_methods(self) -> Self:
        if self.pages != "methods":
            return self
        if missing := [name for name in METHODS_KEEPS if name not in self.keep]:
            raise ValueError(f"keep: pages of methods need {', '.join(missing)} too")
        if not self.sweeps:
            raise ValueError("pages of methods need a sweep for each method")
        if not self.tasks:
            raise ValueError("pages of methods need tasks, and the tasks_version")
        return self

    def _check_tasks(self) -> None:
        """Check that tasks have unique names, keys of no sweep, and together a version."""
        names = [task.name for task in self.tasks]
        if len(set(names)) < len(names):
            raise ValueError("tasks: give each its own name")
        if (self.tasks_version is None) != (not self.tasks):
            raise ValueError("tasks_version: give it with tasks, and only with them")
        taken = {key for sweep in self.all_sweeps for key in sweep.keys}
        for task in self.tasks:
            if twice := sorted(taken.intersection(task.set)):
                raise ValueError(f"task {task.name!r}: {', '.join(twice)} is given by a sweep or above it")

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
        """All keys that may differ between runs, in the order given."""
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
    return built_in_names(BUILT_IN)


def study_text(name: str) -> str:
    """Return the TOML text of a built-in study; InputError if the name is unknown."""
    return built_in_text(BUILT_IN, name, "study")


def load_study(name_or_file: str, *, quick: bool = False) -> Study:
    """Read and check a built-in study or a TOML file, optionally with its table `quick` merged.

    Raises:
        InputError: in one line, the file, the key, the value, and what is allowed.
    """
    path = Path(name_or_file)
    is_file = path.suffix == ".toml" or is_regular(path)
    where = str(path) if is_file else f"study {name_or_file}"
    text = read_toml_text(path, "study") if is_file else study_text(name_or_file)
    tree = parse_toml(text, where, f"skyherd study {study_names()[0]} --show")
    if quick:
        if not isinstance(tree.get("quick"), dict):
            raise InputError(f"{where}: quick", "missing", "a table of the keys that --quick changes")
        tree = _merge(tree, tree["quick"])
    try:
        spec = StudySpec.model_validate(tree)
    except ValidationError as error:
        raise first_error(error, where, "study", see="skyherd study --schema") from None
    return Study(path.stem if is_file else name_or_file, spec, where, path.parent if is_file else Path())


def _merge(under: dict[str, Any], over: dict[str, Any]) -> dict[str, Any]:
    """Merge two trees: tables are merged, other values are replaced."""
    merged = dict(under)
    for key, value in over.items():
        both = isinstance(value, dict) and isinstance(under.get(key), dict)
        merged[key] = _merge(under[key], value) if both else value
    return merged
