"""JSON of any depth, values of other types, and texts that are not UTF-8: a result or a one-line error.

`SKYHERD_FUZZ_EXAMPLES=5 pytest -m slow tests/fuzz/test_fuzz_types.py` tries 6,000 cases.
"""

import json
import tomllib
from pathlib import Path

from fuzzing import (
    FOREIGN_TEXTS,
    SETTABLE,
    TREE_DEPTHS,
    assert_well_behaved,
    contents,
    deep_json,
    fuzzed,
    other_values,
    playground,
    refusal,
    run,
)
from hypothesis import strategies as st
from label_specs import labelled_set

from skyherd.bench.result import read_result
from skyherd.datasets import make_mission, scenario_names, scenario_text
from skyherd.files.output_folder import OutputFolder
from skyherd.live.lab import lab_names, lab_text, make_lab

SET_VERBS = (
    ("scenario", "check", "triangle"),
    ("run", "triangle", "--out", "out"),
    ("live", "check", "webcams", "--no-cameras"),
)
"""Verbs with the option `--set`."""


def scenario_tree(name: str) -> dict:
    return tomllib.loads(scenario_text(name))


def lab_tree(name: str) -> dict:
    return tomllib.loads(lab_text(name))


@fuzzed(12, file=st.sampled_from(["spec.json", "annotations/train.json"]), data=st.data())
def json_of_labelled_sets(file, data):
    """Check very deep JSON, and values of other types below valid keys."""
    with playground() as folder:
        for name, content in labelled_set().items():
            Path("set", name).parent.mkdir(parents=True, exist_ok=True)
            Path("set", name).write_bytes(content)
        Path("set", file).write_bytes(data.draw(other_values(labelled_set()[file]) | deep_json()))
        assert_well_behaved(folder, "dataset", "check", "set", "--sample", "0")


@fuzzed(10, data=st.data())
def records_of_folders(data):
    """Check the record of an output folder, which each verb reads before it writes."""
    good = {
        "about": "x",
        "skyherd": "0",
        "writer": {"verb": "markers", "process": 1, "host": "x", "since": "x"},
        "files": {"a.pdf": {"made_by": "markers", "sha256": "0" * 64}, "b.pdf": {"made_by": "run"}},
    }
    with playground() as folder:
        content = data.draw(other_values(json.dumps(good).encode()) | deep_json())
        Path(".skyherd.json").write_bytes(content)
        before = contents(folder)
        code, err = run("topology", "no-such-scenario", "--out", "x.png")
        assert (code, contents(folder)) == (2, before), err
        output = OutputFolder(folder, "markers", ["a.pdf", "c.pdf"], force=True)
        refusal(output.check)


@fuzzed(
    12, key=st.sampled_from(SETTABLE), value=st.sampled_from(FOREIGN_TEXTS), verb=st.sampled_from(SET_VERBS)
)
def settings_that_are_not_utf8(key, value, verb):
    with playground() as folder:
        assert assert_well_behaved(folder, *verb, "--set", f"{key}={value}") == 2


@fuzzed(20, name=st.sampled_from(scenario_names()), data=st.data())
def types_of_scenario_values(name, data):
    """Check values of other types below valid keys, in the tree of a scenario."""
    good = json.dumps(scenario_tree(name)).encode()
    tree = json.loads(data.draw(other_values(good, TREE_DEPTHS)))
    refusal(lambda: make_mission(tree))


@fuzzed(12, name=st.sampled_from(lab_names()), data=st.data())
def types_of_lab_values(name, data):
    tree = json.loads(data.draw(other_values(json.dumps(lab_tree(name)).encode(), TREE_DEPTHS)))
    refusal(lambda: make_lab(tree))


@fuzzed(6, data=st.data())
def results_of_benchmarks(data):
    """Check `bench.json`, the input of benchmark pages."""
    good = {"environment": {"seed": 1}, "rows": [{"detector": "opencv", "blur_px": 0.5}], "timing": []}
    with playground():
        Path("bench.json").write_bytes(data.draw(other_values(json.dumps(good).encode()) | deep_json()))
        refusal(lambda: read_result(Path()))


test_json_of_labelled_sets, test_json_of_labelled_sets_long = json_of_labelled_sets
test_records_of_folders, test_records_of_folders_long = records_of_folders
test_settings_not_utf8, test_settings_not_utf8_long = settings_that_are_not_utf8
test_types_of_scenario_values, test_types_of_scenario_values_long = types_of_scenario_values
test_types_of_lab_values, test_types_of_lab_values_long = types_of_lab_values
test_results_of_benchmarks, test_results_of_benchmarks_long = results_of_benchmarks
