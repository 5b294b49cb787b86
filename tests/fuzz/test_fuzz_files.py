"""Damaged files for each reader, through the verbs: a result or a one-line error."""

import functools
import io
import os
import tempfile
from pathlib import Path

import cv2
import numpy as np
import pytest
from fuzzing import (
    NASTY_VALUES,
    SETTABLE,
    assert_well_behaved,
    damaged,
    deep_json,
    fuzzed,
    nonsense,
    other_values,
    playground,
    refusal,
)
from hypothesis import strategies as st
from label_specs import labelled_set
from PIL import Image
from study_runs import SMALL

from skyherd.datasets import load_mission, scenario_names, scenario_text
from skyherd.datasets.labelled.spec import spec_text
from skyherd.loop import run_steps
from skyherd.recording.reader import read_recording
from skyherd.recording.writer import McapRecorder
from skyherd.study.store import open_store

PICTURES = {
    "png": "png",
    "jpg": "jpeg",
    "tif": "tiff",
    "bmp": "bmp",
    "gif": "gif",
    "webp": "webp",
    "ppm": "ppm",
}
"""Pillow's format names, by the suffix of a file."""


@functools.cache
def picture(kind: str) -> bytes:
    stream = io.BytesIO()
    grey = np.add.outer(np.arange(24), 2 * np.arange(32)).astype(np.uint8)
    Image.fromarray(grey).save(stream, format=PICTURES[kind])
    return stream.getvalue()


@functools.cache
def video() -> bytes:
    with tempfile.TemporaryDirectory() as folder:
        path = f"{folder}/a.avi"
        writer = cv2.VideoWriter(path, cv2.VideoWriter_fourcc(*"MJPG"), 5, (64, 48))
        for k in range(3):
            writer.write(np.full((48, 64, 3), 40 * k, np.uint8))
        writer.release()
        return Path(path).read_bytes()


@functools.cache
def recording() -> bytes:
    with tempfile.TemporaryDirectory() as folder:
        mission = load_mission("triangle", ["perception=ideal", "duration_s=0.5"])
        path = Path(folder, "run.mcap")
        with McapRecorder(path, mission) as recorder:
            for step in run_steps(mission):
                recorder.write(step)
            recorder.finish(step.time_s, 1.0)
        return path.read_bytes()


@functools.cache
def study_part() -> bytes:
    with tempfile.TemporaryDirectory() as folder, open_store(Path(folder, "out"), "{}") as store:
        store.append([{"key": "a", "error": None, "x": 1.0}, {"key": "b", "error": "broke"}])
        return next(Path(folder, "out", "parts").iterdir()).read_bytes()


@fuzzed(6, kind=st.sampled_from(sorted(PICTURES)), data=st.data())
def pictures(kind, data):
    """Check `detect` and a scenario's template image."""
    with playground() as folder:
        Path(f"a.{kind}").write_bytes(data.draw(damaged(picture(kind))))
        assert_well_behaved(folder, "detect", f"a.{kind}", "--detector", "opencv")
        assert_well_behaved(folder, "scenario", "check", "star", "--set", f'template.image="a.{kind}"')


@fuzzed(4, data=st.data())
def videos(data):
    with playground() as folder:
        Path("a.avi").write_bytes(data.draw(damaged(video())))
        assert_well_behaved(folder, "detect", "a.avi", "--detector", "opencv")


@fuzzed(12, name=st.sampled_from(scenario_names()), data=st.data())
def scenario_files(name, data):
    text = scenario_text(name).encode()
    with playground() as folder:
        Path("a.toml").write_bytes(data.draw(damaged(text) | nonsense(text)))
        assert_well_behaved(folder, "scenario", "check", "a.toml")


@fuzzed(12, key=st.sampled_from(SETTABLE), value=st.sampled_from(NASTY_VALUES))
def settings_of_scenarios(key, value):
    with playground() as folder:
        assert_well_behaved(folder, "scenario", "check", "triangle", "--set", f"{key}={value}")


@fuzzed(8, data=st.data())
def recordings(data):
    """Check only the reader; reports of complete steps have tests of their own."""
    with playground():
        Path("run.mcap").write_bytes(data.draw(damaged(recording())))
        refusal(lambda: read_recording(Path("run.mcap")))


@fuzzed(
    5,
    file=st.sampled_from(["spec.json", "truth.csv", "images.csv", "data.yaml", "annotations/train.json"]),
    data=st.data(),
)
def tables_of_labelled_sets(file, data):
    with playground() as folder:
        for name, content in labelled_set().items():
            Path("set", name).parent.mkdir(parents=True, exist_ok=True)
            Path("set", name).write_bytes(content)
        good = labelled_set()[file]
        other = other_values(good) | deep_json() if file.endswith(".json") else st.nothing()
        Path("set", file).write_bytes(data.draw(damaged(good) | other))
        assert_well_behaved(folder, "dataset", "check", "set", "--sample", "0")


@fuzzed(6, data=st.data())
def specs_of_labelled_sets(data):
    text = spec_text("small").encode()
    with playground() as folder:
        Path("a.toml").write_bytes(data.draw(damaged(text) | nonsense(text)))
        Path("out").write_text("a file in the way, so that a spec that is good is refused as well")
        assert_well_behaved(folder, "dataset", "make", "a.toml", "--out", "out", "--jobs", "1")


@fuzzed(6, data=st.data())
def study_files(data):
    text = SMALL.encode()
    with playground() as folder:
        Path("a.toml").write_bytes(data.draw(damaged(text) | nonsense(text)))
        assert_well_behaved(folder, "study", "a.toml", "--dry-run", "--out", "out")


@fuzzed(5, data=st.data())
def parts_of_studies(data):
    with playground() as folder:
        Path("a.toml").write_text(SMALL)
        Path("out/parts").mkdir(parents=True)
        Path("out/study.json").write_text("{}")
        Path("out/parts/00000001.parquet").write_bytes(data.draw(damaged(study_part())))
        assert_well_behaved(folder, "study", "a.toml", "--dry-run", "--out", "out")


SETS = b"""
[desk]
files = ["*.png"]
dictionary = "4X4_50"
border_bits = 1
inverted = false
ids_repeat = true
every = 1

[desk.board]
kind = "charuco"
columns = 3
rows = 3
marker = 0.75
legacy = false
gap = 0.3
first_id = 0
name = "desk"
degree = 2
"""
"""Photograph sets with all keys."""


@fuzzed(4, verb=st.sampled_from(["photographs", "boards"]), data=st.data())
def sets_of_photographs(verb, data):
    with playground() as folder:
        Path("in").mkdir()
        Path("in/photographs.toml").write_bytes(data.draw(damaged(SETS) | nonsense(SETS)))
        Path("in/a.png").write_bytes(picture("png"))
        assert_well_behaved(folder, "bench", verb, "in", "--detector", "opencv", "--out", "out")


test_pictures, test_pictures_long = pictures
test_videos, test_videos_long = videos
test_scenario_files, test_scenario_files_long = scenario_files
test_settings, test_settings_long = settings_of_scenarios
test_recordings, test_recordings_long = recordings
test_tables_of_labelled_sets, test_tables_of_labelled_sets_long = tables_of_labelled_sets
test_specs_of_labelled_sets, test_specs_of_labelled_sets_long = specs_of_labelled_sets
test_study_files, test_study_files_long = study_files
test_parts_of_studies, test_parts_of_studies_long = parts_of_studies
test_sets_of_photographs, test_sets_of_photographs_long = sets_of_photographs


@pytest.mark.parametrize("verb", [["run"], ["topology"], ["study"], ["dataset", "make"]], ids=" ".join)
def test_each_verb_refuses_pipes_and_devices(verb):
    with playground() as folder:
        os.mkfifo("a.toml")
        for name in ("a.toml", "/dev/zero", "."):
            assert assert_well_behaved(folder, *verb, name) == 2
