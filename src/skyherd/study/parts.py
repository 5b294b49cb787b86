"""Variation between the runs of a study: values of keys, grids, draws, sweeps and tasks."""

from typing import Annotated, Any, Self

from pydantic import BeforeValidator, Field, model_validator

from skyherd.datasets import Model
from skyherd.datasets.configuration.fields import Coordinate, Positive, Seed
from skyherd.errors import InputError, join_errors


def _keys(tree: Any) -> Any:
    """Convert `{a: {b: value}}` to `{"a.b": value}`: TOML reads an unquoted dotted key as tables."""
    if not isinstance(tree, dict):
        return tree
    flat: dict[str, Any] = {}
    for key, value in tree.items():
        if isinstance(value, dict) and not (value and value.keys() <= DrawModel.model_fields.keys()):
            flat |= {f"{key}.{rest}": leaf for rest, leaf in _keys(value).items()}
        else:
            flat[key] = value
    return flat


def _kind(value: Any) -> Any:
    return {"uniform": value} if isinstance(value, list | tuple) else value


Whole = Annotated[int, Field(gt=-(2**63), lt=2**63)]
"""An integer that TOML and JSON can hold."""


class DrawModel(Model):
    """Distribution of a key's values: exactly one of these; `[a, b]` alone is `uniform`."""

    uniform: tuple[Coordinate, Coordinate] | None = Field(None, description="[least, greatest]")
    log: tuple[Positive, Positive] | None = Field(
        None, description="[least, greatest], above 0; uniform in the logarithm"
    )
    whole: tuple[Whole, Whole] | None = Field(None, description="[first, last], each whole number as likely")
    choice: list[Any] | None = Field(None, min_length=1, description="one of these, each as likely")

    @model_validator(mode="after")
    def _one(self) -> Self:
        given = [value for value in (self.uniform, self.log, self.whole, self.choice) if value is not None]
        if len(given) != 1:
            what = f"{len(given)} kinds of draw given"
            raise InputError("", what, "[least, greatest], or exactly one of log, whole and choice")
        for span in (self.uniform, self.log, self.whole):
            if span is not None and span[0] > span[1]:
                raise InputError("", f"[{span[0]:g}, {span[1]:g}]", "a range with the smaller number first")
        return self


class RandomModel(Model):
    """Random parameters: draw number i of a key depends on seed, i and key alone."""

    runs: Annotated[int, Field(ge=1, le=1_000_000)] = Field(description="number of draws of all keys")
    seed: Seed = Field(1, description="of the draws")
    draw: Annotated[dict[str, Annotated[DrawModel, BeforeValidator(_kind)]], BeforeValidator(_keys)] = Field(
        min_length=1, description="distribution of each key of the scenario"
    )


class Parts(Model):
    """Values that replace those of the scenario, by key; `*` matches every item of a list."""

    set: Annotated[dict[str, Any], BeforeValidator(_keys)] = Field({}, description="one value a key")
    grid: Annotated[dict[str, Annotated[list[Any], Field(min_length=1)]], BeforeValidator(_keys)] = Field(
        {}, description="values of each key; every combination is run"
    )
    random: RandomModel | None = Field(None, description="parameters drawn at random")

    @property
    def keys(self) -> list[str]:
        """Return all replaced keys of the scenario, in the order given."""
        return [*self.set, *self.grid, *(self.random.draw if self.random else ())]

    @model_validator(mode="after")
    def _once(self) -> Self:
        if twice := sorted({key for key in self.keys if self.keys.count(key) > 1}):
            problems = [
                InputError("", f"{key} is given twice", "each key once, in set, grid or random.draw")
                for key in twice
            ]
            raise join_errors(problems)
        return self


class SweepModel(Parts):
    """One series of runs; its keys override those at the top of the study, which override the scenario's."""

    name: str = Field(min_length=1, description="name of the sweep in the table")
    about: str = Field("", description="description for pages")

    def over(self, top: Parts) -> "SweepModel":
        """Return the sweep with missing keys taken from the top of the study."""
        mine = set(self.keys)
        random = self.random
        if random is None and top.random is not None:
            draw = {key: value for key, value in top.random.draw.items() if key not in mine}
            random = top.random.model_copy(update={"draw": draw}) if draw else None
        return SweepModel.model_construct(
            name=self.name,
            about=self.about,
            set={key: value for key, value in top.set.items() if key not in mine} | self.set,
            grid={key: values for key, values in top.grid.items() if key not in mine} | self.grid,
            random=random,
        )


class TaskModel(Model):
    """One task of a set; every sweep performs it, with its own keys beside those of the task."""

    name: str = Field(min_length=1, description="name of the task in the table")
    about: str = Field("", description="description for pages")
    set: Annotated[dict[str, Any], BeforeValidator(_keys)] = Field(
        {}, description="one value a key of the scenario"
    )
