"""Computations of the live benchmarks, on known input."""

import json
import tomllib

import numpy as np
import pytest

from skyherd.live.lab import lab_names, load_lab, make_lab


@pytest.mark.parametrize("name", lab_names())
def test_lab_round_trips_through_toml(load_benchmark, name) -> None:
    latency = load_benchmark("live_latency")
    tree = load_lab(name).model.model_dump(mode="json", exclude_none=True)
    assert make_lab(tomllib.loads(latency.toml_text(tree))).model == load_lab(name).model


def test_lab_of_scenario_has_one_camera_and_dry_run_robots(load_benchmark) -> None:
    lab = load_benchmark("live_latency").lab_of("star", detector="opencv")
    assert [camera.detector for camera in lab.model.cameras] == ["opencv"]
    assert {robot.driver for robot in lab.model.robots} == {"dry-run"}
    assert lab.ids == load_lab("star").ids


def test_memory_growth_distinguishes_leak_from_noise(load_benchmark) -> None:
    """Correlated noise, typical of memory, is no growth. A leak of 12 MiB/h is."""
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


def test_memory_of_ended_process_is_nan(load_benchmark) -> None:
    memory = load_benchmark("live_memory")
    assert np.isnan(memory.own_mib(2**30))


def test_fault_runs_resume_after_interrupt(load_benchmark, tmp_path, monkeypatch) -> None:
    """Recorded runs are not repeated, and runs completed before the interrupt are in the file."""
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
