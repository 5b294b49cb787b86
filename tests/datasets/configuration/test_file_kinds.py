"""Recognition of files of a wrong kind; the error names the verb that accepts them."""

import tomllib

import pytest

from skyherd.datasets import (
    DatasetSpec,
    Scenario,
    built_in_names,
    built_in_text,
    load_mission,
    load_spec,
    parse_toml,
    read_toml_text,
)
from skyherd.datasets.configuration.file_kinds import (
    DATASET,
    KINDS,
    LAB,
    MCAP_MAGIC,
    SCENARIO,
    STUDY,
    recognize,
    refuse_configuration,
)
from skyherd.errors import InputError
from skyherd.live.lab import LabModel, load_lab
from skyherd.study.spec import StudySpec, load_study

MODELS = {SCENARIO: Scenario, LAB: LabModel, STUDY: StudySpec, DATASET: DatasetSpec}
LOADERS = {SCENARIO: load_mission, LAB: load_lab, STUDY: load_study, DATASET: load_spec}
BUILT_IN = [(kind, name) for kind in KINDS for name in built_in_names(kind.package)]


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.name)
def test_keys_of_each_kind_are_those_of_its_model(kind):
    fields = MODELS[kind].model_fields
    assert kind.required == {name for name, field in fields.items() if field.is_required()}
    assert kind.required | kind.optional == fields.keys()


@pytest.mark.parametrize(("kind", "name"), BUILT_IN)
def test_every_built_in_file_is_recognized(kind, name):
    assert recognize(tomllib.loads(built_in_text(kind.package, name, "file"))) is kind


@pytest.mark.parametrize(("kind", "name"), BUILT_IN)
def test_file_with_a_byte_order_mark_is_read(kind, name, tmp_path):
    text = built_in_text(kind.package, name, "file")
    (tmp_path / "plain.toml").write_text(text, "utf-8")
    (tmp_path / "marked.toml").write_text(text, "utf-8-sig")
    plain, marked = (read_toml_text(tmp_path / f"{stem}.toml", "file") for stem in ("plain", "marked"))
    assert recognize(parse_toml(marked, "marked.toml", "")) is kind and marked == plain


@pytest.mark.parametrize("tree", [{}, {"a": 1}, {"seed": 1}, {"name": "x", "b": 1, "c": 2}])
def test_a_file_of_no_kind_is_not_recognized(tree):
    assert recognize(tree) is None


@pytest.mark.parametrize("wanted", KINDS, ids=lambda kind: kind.name)
@pytest.mark.parametrize(("kind", "name"), BUILT_IN)
def test_a_file_of_another_kind_names_the_verb_that_takes_it(kind, name, wanted, tmp_path):
    file = tmp_path / "mine.toml"
    file.write_text(built_in_text(kind.package, name, "file"))
    if wanted is kind:
        if kind is not DATASET:
            assert LOADERS[wanted](str(file))
        return
    with pytest.raises(InputError) as refused:
        LOADERS[wanted](str(file))
    said = f"{file}: is a {kind.name}, not a {wanted.name}; give it to {kind.taken_by}"
    assert str(refused.value) == said


@pytest.mark.parametrize(
    ("wanted", "name", "said"),
    [
        (SCENARIO, "webcams", "'webcams': is a lab, not a scenario; give it to `skyherd live run`"),
        (LAB, "grid", "'grid': is a scenario, not a lab; give it to `skyherd run`"),
        (STUDY, "small", "'small': is a dataset spec, not a study; give it to `skyherd dataset make`"),
        (DATASET, "noise", "'noise': is a study, not a dataset spec; give it to `skyherd study`"),
    ],
)
def test_a_built_in_name_of_another_kind_is_recognized(wanted, name, said):
    with pytest.raises(InputError) as refused:
        LOADERS[wanted](name)
    assert str(refused.value).startswith(said)


@pytest.mark.parametrize("wanted", KINDS, ids=lambda kind: kind.name)
@pytest.mark.parametrize("name", ["run.mcap", "mine.toml", "recording"])
def test_a_recording_is_recognized_by_its_first_bytes(wanted, name, tmp_path):
    (tmp_path / name).write_bytes(MCAP_MAGIC + b"\0" * 40)
    with pytest.raises(InputError, match=f"is a recording, not a {wanted.name}; .*skyherd topology"):
        LOADERS[wanted](str(tmp_path / name))


def test_the_folder_of_a_run_is_recognized(tmp_path):
    (tmp_path / "run.mcap").write_bytes(MCAP_MAGIC)
    with pytest.raises(InputError, match=r"is the folder of a run, not a scenario; .*skyherd report"):
        load_mission(str(tmp_path))


def test_a_file_with_a_mistyped_key_keeps_its_kind(tmp_path):
    text = built_in_text(SCENARIO.package, "star", "scenario").replace("duration_s", "duration", 1)
    (tmp_path / "mine.toml").write_text(text)
    with pytest.raises(InputError, match=r"duration: unknown key; did you mean 'duration_s'\?"):
        load_mission(str(tmp_path / "mine.toml"))


def test_a_configuration_where_a_run_is_wanted_is_refused(tmp_path):
    (tmp_path / "mine.toml").write_text(built_in_text(LAB.package, "webcams", "lab"))
    with pytest.raises(InputError, match="is a lab, not a run; give it to `skyherd live run`"):
        refuse_configuration(tmp_path / "mine.toml", "run")
    (tmp_path / "other.toml").write_text("a = 1")
    refuse_configuration(tmp_path / "other.toml", "run")
    refuse_configuration(tmp_path / "absent.toml", "run")
