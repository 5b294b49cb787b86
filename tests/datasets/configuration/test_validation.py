"""Errors of configuration files: every key, all at once, unknown ones first, in skyherd's own wording."""

import pickle
import re
import tomllib
from itertools import pairwise
from typing import Annotated, Literal

import pytest
from pydantic import AfterValidator, Field

from skyherd.datasets import DatasetSpec, Model, Scenario, load_mission, scenario_text
from skyherd.datasets.configuration.validation import RENAMED_BEGINNINGS, check_tree, locate, renamed
from skyherd.datasets.labelled.spec import spec_text
from skyherd.errors import MAX_PROBLEMS, InputError, InputErrors
from skyherd.live.lab import LabModel, lab_text
from skyherd.study.spec import StudySpec, study_text

MODELS = {
    Scenario: scenario_text("star"),
    LabModel: lab_text("webcams"),
    StudySpec: study_text("noise"),
    DatasetSpec: spec_text("varied"),
}
"""Kinds of files, each with a valid example."""

PYDANTIC = (
    "input should be",
    "extra inputs",
    "value error",
    "field required",
    "unable to parse",
    "valid ",
    "instance of",
    "should have",
    "pydantic",
    "at least 1 character",
    "validation error",
)
"""Words of Pydantic's messages, in lower case."""

FREE = {"set", "grid", "quick", "draw", "choice"}
"""Keys of studies whose values have any type."""


def leaves(model, node=None, path=(), level=0):
    """Yield the path to each value of a model that is not a table, with its schema."""
    top = model.model_json_schema()
    yield from _leaves(top if node is None else node, top, path, level)


def _leaves(node, top, path, level):
    if "$ref" in node:
        node = top["$defs"][node["$ref"].rsplit("/", 1)[-1]]
    options = [option for option in node.get("anyOf", [node]) if option.get("type") != "null"]
    if len(options) == 1 and options[0] is not node:
        yield from _leaves(options[0], top, path, level)
    elif "properties" in node and level < 8:
        for key, below in node["properties"].items():
            if key not in FREE:
                yield from _leaves(below, top, (*path, key), level + 1)
    elif "$ref" in str(node.get("items", "")):
        yield from _leaves(node["items"], top, (*path, 0), level + 1)
    else:
        yield path, node


def wrong_values(schema):
    """Yield values of a wrong type for a leaf, and numbers out of any range."""
    yield from ([[]], {"a": {}}, 1e300, -1e300)
    if schema.get("type") != "string" or "enum" in schema:
        yield "wrong"


def put(tree, path, value):
    """Put a value into a tree, and create the tables and items on its path."""
    for part, following in pairwise(path):
        if isinstance(part, int):
            tree.extend([{}] * (part + 1 - len(tree)))
        elif part not in tree:
            tree[part] = [] if isinstance(following, int) else {}
        tree = tree[part]
    if isinstance(tree, list):
        tree.extend([{}] * (path[-1] + 1 - len(tree)))
    tree[path[-1]] = value


def cases():
    for model, text in MODELS.items():
        for path, schema in leaves(model):
            yield pytest.param(model, text, path, schema, id=f"{model.__name__}-{'.'.join(map(str, path))}")


@pytest.mark.parametrize(("model", "text", "path", "schema"), list(cases()))
def test_wrong_value_of_each_key_is_told_in_own_words(model, text, path, schema):
    refused = 0
    for value in wrong_values(schema):
        tree = tomllib.loads(text)
        put(tree, path, value)
        try:
            check_tree(model, tree, "file.toml", see="skyherd VERB schema")
        except InputError as error:
            assert len(error.lines) <= MAX_PROBLEMS + 1
            for line in error.lines:
                assert not [words for words in PYDANTIC if words in line.lower()], line
                assert len(line) < 500 and "; " in line and "\n" not in line
            key = ".".join(map(str, path))
            assert any(f"file.toml: {key}" in line for line in error.lines), error.lines
            refused += 1
    assert refused


def test_keys_of_all_kinds_of_files_are_walked():
    """Negative control of the test above: it tries deep keys."""
    walked = {model: {path for path, _ in leaves(model)} for model in MODELS}
    assert ("units", 0, "camera", "distortion", "k1") in walked[Scenario]
    assert ("cameras", 0, "flight", "speed_mps") in walked[LabModel]
    assert ("sensor", "lens_blur", "coma_px") in walked[DatasetSpec]
    assert ("figures", 0, "x") in walked[StudySpec]
    assert sum(map(len, walked.values())) > 200


def refused(text):
    with pytest.raises(InputError) as caught:
        check_tree(Scenario, tomllib.loads(text), "a.toml", see="skyherd scenario schema")
    return caught.value


def star(*changes):
    text = scenario_text("star")
    for old, new in changes:
        assert old in text
        text = text.replace(old, new, 1)
    return text


def test_unknown_keys_come_first_and_all_problems_together():
    error = refused(
        star(
            ("[marker]", "[marker]\nsize_m = 1"),
            ("[template]", "sed = 3\n[template]"),
            ("duration_s = ", "duration_s = -"),
        )
    )
    lines = [line.removeprefix("a.toml: ") for line in error.lines]
    assert isinstance(error, InputErrors)
    assert lines[0] == "sed: unknown key; did you mean 'seed'?"
    assert lines[1] == "marker.size_m: unknown key; did you mean 'side_m'?"
    assert lines[2].startswith("duration_s: -")
    assert str(error) == "\n".join(error.lines)
    assert (error.where, error.what) == ("a.toml: sed", "unknown key")


def test_unknown_key_of_another_table_names_its_place():
    assert refused(star(("[marker]", "[marker]\nhysteresis = 1"))).lines == (
        "a.toml: marker.hysteresis: unknown key; did you mean 'selection.hysteresis'?",
    )


def test_unknown_key_of_an_optional_table_gets_the_nearest():
    with pytest.raises(InputError) as caught:
        load_mission("grid", ["robots.scatter.jitter=1"])
    assert str(caught.value) == "settings: robots.scatter.jitter: unknown key; did you mean 'jitter_m'?"


@pytest.mark.parametrize(
    ("setting", "meant"),
    [
        ("marker.dictionary=DICT_4X4_51", "4X4_50"),
        ("detector=trakcing", "tracking"),
        ("template={shape='start'}", "star"),
        ("units.0.camera.preset=phnoe", "phone"),
        ("control.method=bearing-onyl", "bearing-only"),
        ("perception=nosiy", "noisy"),
    ],
)
def test_mistyped_name_gets_the_nearest_known_one(setting, meant):
    with pytest.raises(InputError, match=rf"did you mean '{meant}'\? one of "):
        load_mission("star", [setting])


def test_missing_key_tells_what_it_is():
    said = str(refused(star(("side_m", "# side_m"))))
    assert said.startswith("a.toml: marker.side_m: missing; give a finite number from 0.001 to 1000 (m; side")


def test_more_problems_than_the_limit_are_counted():
    positions = ", ".join(["[nan, 0]"] * (MAX_PROBLEMS + 3))
    tree = tomllib.loads(scenario_text("star"))
    tree["robots"] = tomllib.loads(f"positions_m = [{positions}]")
    with pytest.raises(InputErrors) as caught:
        check_tree(Scenario, tree, "a.toml", see="")
    assert len(caught.value.lines) == MAX_PROBLEMS + 1
    assert caught.value.lines[-1] == "and 3 more problems"


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("least_spacing_sides", "min_spacing_sides"),
        ("smallest_side_px", "min_side_px"),
        ("most_speed_mps", "max_speed_mps"),
        ("largest_height_m", "max_height_m"),
        ("leastwise", None),
        ("speed_mps", None),
    ],
)
def test_renamed_key_gets_its_new_name(old, new):
    assert renamed(old) == new


def test_prefixes_of_renamed_keys_are_refused_with_new_name():
    for old, new in RENAMED_BEGINNINGS.items():
        setting = f"autopilot.{old}height_m=5"
        with pytest.raises(InputError) as caught:
            load_mission("star", [setting])
        assert str(caught.value) == (
            f"settings: autopilot.{old}height_m: unknown key; renamed to {new}height_m"
        )


def test_old_key_of_a_nested_list_is_refused_with_the_new_name():
    with pytest.raises(
        InputError, match=r"units\.0\.flight\.least_side_px: unknown key; renamed to min_side_px"
    ):
        load_mission("star", ["units.0.flight.least_side_px=8"])


@pytest.mark.parametrize(
    ("settings", "lines"),
    [
        (["control.k=-1"], ["settings: control.k: -1; a finite number from"]),
        (["contrl.k=1"], ["settings: contrl.k: unknown key; did you mean 'control'?"]),
        (["units.*.height_m=x"], ["settings: units.*.height_m: 'x'; ", "settings: units.*.height_m: 'x'; "]),
        (
            ["marker={size=1}"],
            ["settings: marker: size: unknown key; ", "settings: marker: side_m: missing; "],
        ),
        (["detector=best"], ["settings: detector: no detector 'best'; one of "]),
        (["seed"], ["settings: 'seed' is not of the form KEY=VALUE; such as control.k=0.2"]),
        (["duration_s.x=1"], ["settings: duration_s.x: nothing is called 'x' there; "]),
        (["units.9.height_m=1"], ["settings: units.9.height_m: no item '9' in the list; 0 to 2, or *"]),
    ],
)
def test_problem_of_a_setting_names_the_option(settings, lines):
    with pytest.raises(InputError) as caught:
        load_mission("star", settings)
    for line in lines:
        assert any(said.startswith(line) for said in caught.value.lines), caught.value.lines
    assert all(said.startswith("settings: ") for said in caught.value.lines)


def test_seed_out_of_range_names_its_option():
    with pytest.raises(InputError, match=r"^seed: -1; a whole number"):
        load_mission("star", seed=-1)


@pytest.mark.parametrize(
    ("key", "place"),
    [
        ("a.b", "file: a.b"),
        ("", "file"),
        ("units.3.camera.lens", "settings: units.*.camera: lens"),
        ("units.3.camera", "settings: units.*.camera"),
        ("units.3", "file: units.3"),
    ],
)
def test_place_of_a_problem(key, place):
    assert locate("file", key, {"units.*.camera": "settings: units.*.camera"}) == place


def _even(value):
    if value % 2:
        raise InputError("", "", "an even number")
    return value


class _Small(Model):
    kind: Literal["near", "far"] = Field("near")
    count: Annotated[int, AfterValidator(_even)] = Field(2)


@pytest.mark.parametrize(
    ("tree", "said"),
    [
        ({"kind": "nera"}, "a: kind: 'nera'; did you mean 'near'? one of near, far"),
        ({"kind": 3}, "a: kind: 3; one of near, far"),
        ({"count": 3}, "a: count: 3; an even number"),
        ({"count": 2.5}, "a: count: 2.5; a whole number"),
    ],
)
def test_words_of_a_problem(tree, said):
    with pytest.raises(InputError) as caught:
        check_tree(_Small, tree, "a", see="")
    assert str(caught.value) == said


@pytest.mark.parametrize(
    ("setting", "said"),
    [
        ("marker.side_m='0.5'", "'0.5'; a finite number from 0.001 to 1000"),
        ("duration_s=true", "True; a finite number"),
        ("seed='1'", "'1'; a whole number"),
        ("robots.positions_m=[[0, '1'], [1, 1]]", "'1'; a finite number"),
    ],
)
def test_text_and_true_are_no_numbers(setting, said) -> None:
    """Pydantic takes both for numbers."""
    with pytest.raises(InputError, match=re.escape(said)):
        load_mission("triangle", [setting])


def test_errors_survive_the_way_between_processes():
    error = refused(star(("[template]", "sed = 3\n[template]"), ("duration_s = ", "duration_s = -")))
    again = pickle.loads(pickle.dumps(error))
    assert type(again) is InputErrors and again.lines == error.lines
    assert [line.partition(": ")[0] for line in error.within("x").lines] == ["x", "x"]
