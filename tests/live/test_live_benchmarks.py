"""What the benchmarks of live runs compute, on what is known."""

import json
import tomllib

import numpy as np
import pytest

from skyherd.live.lab import lab_names, load_lab, make_lab


@pytest.mark.parametrize("name", lab_names())
def test_a_lab_written_as_toml_is_the_same_lab(load_benchmark, name) -> None:
    latency = load_benchmark("live_latency")
    tree = load_lab(name).model.model_dump(mode="json", exclude_none=True)
    assert make_lab(tomllib.loads(latency.toml_text(tree))).model == load_lab(name).model


def test_the_lab_of_a_scenario_has_one_camera_and_robots_without_wheels(load_benchmark) -> None:
    lab = load_benchmark("live_latency").lab_of("star", detector="opencv")
    assert [camera.detector for camera in lab.model.cameras] == ["opencv"]
    assert {robot.driver for robot in lab.model.robots} == {"dry-run"}
    assert lab.ids == load_lab("star").ids


def test_memory_that_grows_is_told_from_memory_that_does_not(load_benchmark) -> None:
    """Noise that stays for some readings, as memory's does, is no growth; a leak of 12 MiB an hour is."""
    memory = load_benchmark("live_memory")
    times_s = np.arange(0.0, 1200.0, 5.0)
    rng = np.random.default_rng(6)
    noise = np.repeat(rng.normal(size=24), 10)
    start = 30 * np.exp(-times_s / 30)
    watched = {
        "times_s": times_s.tolist(),
        "mib": {
            "unit/0": (100 - start + 0.05 * noise).tolist(),
            "robot/1": (80 - start + 0.05 * noise + times_s / 300).tolist(),
        },
    }
    flat, leaks = memory.judge(watched)
    assert abs(flat["grows_mib_per_hour"]) < 2 * flat["within_mib_per_hour"] < 2.0
    assert leaks["grows_mib_per_hour"] == pytest.approx(12.0, abs=2 * leaks["within_mib_per_hour"])
    assert leaks["grows_mib_per_hour"] > 5 * leaks["within_mib_per_hour"]
    assert leaks["gained_mib"] == pytest.approx(0.9 * 900 / 300, abs=0.2)


def test_a_process_that_is_gone_has_no_memory(load_benchmark) -> None:
    memory = load_benchmark("live_memory")
    assert np.isnan(memory.own_mib(2**30))


def test_faults_that_were_interrupted_are_gone_on_with(load_benchmark, tmp_path, monkeypatch) -> None:
    """What the file has is not run again, and what was run before it was interrupted is in the file."""
    faults, path, ran = load_benchmark("live_faults"), tmp_path / "faults.json", []

    def run(fault, seed):
        ran.append((fault, seed))
        if len(ran) == 4:
            raise KeyboardInterrupt
        return {"fault": fault, "seed": seed}

    def start(*options):
        monkeypatch.setattr("sys.argv", ["live_faults", "--times", "2", "--json", str(path), *options])
        faults.measure("", ("one", "other"), run, lambda rows: str(len(rows)))

    with pytest.raises(KeyboardInterrupt):
        start()
    start("--go-on")
    assert ran == [("one", 0), ("other", 0), ("one", 1), ("other", 1), ("other", 1)]
    assert len(json.loads(path.read_text())) == 4
