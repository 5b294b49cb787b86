"""Interpretation of a study's file: grids, sweeps, draws, keys."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from skyherd.datasets import load_mission, make_mission
from skyherd.errors import InputError
from skyherd.study.parts import RandomModel
from skyherd.study.plan import draw_settings, make_plan, mission_key, sweep_settings
from skyherd.study.spec import StudySpec, load_study, study_names


@pytest.mark.smoke
def test_grid_is_enumerated_with_last_key_fastest(write_study: Any) -> None:
    runs = make_plan(load_study(str(write_study()))).runs
    pairs = [(run.parameters["control.k"], run.parameters["units.0.yaw_deg"]) for run in runs]
    assert pairs == [(k, yaw) for k in (0.1, 0.3) for yaw in (0.0, 90.0, 180.0)]
    assert len({run.key for run in runs}) == 6


def test_mission_matches_skyherd_run(write_study: Any) -> None:
    plan = make_plan(load_study(str(write_study())))
    settings = ["perception=ideal", "duration_s=0.4", "control.k=0.3", "units.0.yaw_deg=180"]
    by_hand = load_mission("triangle", settings)
    assert plan.mission(plan.runs[-1]).scenario == by_hand.scenario
    assert plan.runs[-1].key == mission_key(by_hand)


def test_quick_overrides_study_keys(write_study: Any) -> None:
    quick = load_study(str(write_study()), quick=True)
    assert quick.spec.grid == {"control.k": [0.1], "units.0.yaw_deg": [0, 90, 180]}
    assert len(make_plan(quick).runs) == 3


def test_quoted_and_nested_keys_are_equal() -> None:
    nested = {
        "grid": {"sensor": {"noise": [1.0]}},
        "random": {"runs": 2, "draw": {"marker": {"side_m": [1, 2]}}},
    }
    quoted = {"grid": {"sensor.noise": [1.0]}, "random": {"runs": 2, "draw": {"marker.side_m": [1, 2]}}}
    about = {"scenario": "star", "keep": ["scale"]}
    assert StudySpec.model_validate(about | nested) == StudySpec.model_validate(about | quoted)


def test_star_matches_every_list_item(write_study: Any) -> None:
    text = 'scenario = "star"\nkeep = ["scale"]\n[grid]\n"units.*.height_m" = [20, 25]\n'
    plan = make_plan(load_study(str(write_study(text))))
    heights = [[unit.height_m for unit in plan.mission(run).scenario.units] for run in plan.runs]
    assert heights == [[20.0] * 3, [25.0] * 3]
    assert [run.parameters["units.*.height_m"] for run in plan.runs] == [20.0, 25.0]


def test_sweep_overrides_top_and_crosses_grid(write_study: Any) -> None:
    text = """
    scenario = "triangle"
    keep = ["scale"]
    grid = { seed = [1, 2], "control.k" = [0.1] }
    [[sweeps]]
    name = "yaw"
    grid = { "units.0.yaw_deg" = [0, 45, 90] }
    [[sweeps]]
    name = "gain"
    set = { "control.k" = 0.3 }
    """
    runs = make_plan(load_study(str(write_study(text)))).runs
    found = [
        (run.sweep, *(run.parameters[key] for key in ("seed", "control.k", "units.0.yaw_deg")))
        for run in runs
    ]
    yaw = [("yaw", seed, 0.1, turn) for seed in (1, 2) for turn in (0.0, 45.0, 90.0)]
    assert found == [*yaw, ("gain", 1, 0.3, 0.0), ("gain", 2, 0.3, 0.0)]


def test_draws_depend_only_on_seed_number_and_key() -> None:
    """More runs, more keys or another order change no value: completed runs need not be repeated."""
    some = RandomModel.model_validate({"runs": 2, "seed": 7, "draw": {"a": [0, 1], "b": {"log": [1, 100]}}})
    more = RandomModel.model_validate(
        {"runs": 9, "seed": 7, "draw": {"c": {"whole": [1, 6]}, "b": {"log": [1, 100]}, "a": [0, 1]}}
    )
    for number in range(2):
        fewer, all_keys = draw_settings(some, number), draw_settings(more, number)
        assert fewer == {key: all_keys[key] for key in fewer}
    assert draw_settings(some, 0) != draw_settings(some, 1)
    assert draw_settings(some, 0) != draw_settings(some.model_copy(update={"seed": 8}), 0)


def test_draws_follow_distribution() -> None:
    """Means of N draws within 5 standard deviations: range / sqrt(12 N), or 1 / sqrt(4 N) of two."""
    draw = {"u": [2, 4], "l": {"log": [1, 100]}, "w": {"whole": [1, 6]}, "c": {"choice": ["x", "y"]}}
    model = RandomModel.model_validate({"runs": 1, "draw": draw})
    n = 2000
    rows = [draw_settings(model, number) for number in range(n)]
    bound = 5 / np.sqrt(12 * n)
    u, logs = np.array([row["u"] for row in rows]), np.log10([row["l"] for row in rows])
    whole = np.array([row["w"] for row in rows])
    assert u.min() >= 2 and u.max() <= 4 and abs(u.mean() - 3) < 2 * bound
    assert logs.min() >= 0 and logs.max() <= 2 and abs(logs.mean() - 1) < 2 * bound
    assert set(whole.tolist()) == {1, 2, 3, 4, 5, 6} and abs(whole.mean() - 3.5) < 6 * bound
    assert abs(np.mean([row["c"] == "x" for row in rows]) - 0.5) < 5 / np.sqrt(4 * n)


def test_key_covers_inputs_of_run(scenario_tree: Any, tmp_path: Path) -> None:
    def key(**changes: Any) -> str:
        return mission_key(make_mission(scenario_tree("triangle") | changes, folder=tmp_path))

    base = key()
    assert key(description="another word") == base
    assert key(seed=2) != base
    assert key(duration_s=119.9) != base
    reordered = dict(reversed(scenario_tree("triangle").items()))
    assert mission_key(make_mission(reordered)) == base


def test_key_covers_picture_content_not_path(scenario_tree: Any, tmp_path: Path) -> None:
    def key(name: str, grey: int) -> str:
        Image.new("L", (64, 64), grey).save(tmp_path / name)
        ground = {"kind": "image", "image": name}
        return mission_key(make_mission(scenario_tree("triangle") | {"ground": ground}, folder=tmp_path))

    assert key("a.png", 90) == key("b.png", 90) != key("c.png", 91)


def test_key_covers_version(monkeypatch: pytest.MonkeyPatch) -> None:
    mission = load_mission("triangle")
    before = mission_key(mission)
    monkeypatch.setattr("skyherd.study.plan.__version__", "0.0.0")
    assert mission_key(mission) != before


def test_documented_example_is_valid(write_study: Any) -> None:
    page = Path(__file__).parents[2] / "docs" / "studies.md"
    example = page.read_text("utf-8").split("```toml\n")[1].split("```")[0]
    plan = make_plan(load_study(str(write_study(example)), quick=True))
    assert len(plan.runs) == 20 * 3 * 1 * 3
    assert {run.sweep for run in plan.runs} == {"tilt"}


BENCHMARKS = Path(__file__).parents[2] / "benchmarks"
STUDIES = [
    *study_names(),
    *(str(BENCHMARKS / name) for name in ("ablation.toml", "gains.toml")),
]
"""Studies that users run, and those that measure the project."""


def test_the_projects_own_studies_are_not_built_in() -> None:
    assert study_names() == ["invariance", "methods", "noise"]


@pytest.mark.parametrize("name", STUDIES)
def test_built_in_studies_are_valid_with_quick_form(name: str) -> None:
    """Each run of the quick form is checked; those of the full one are counted."""
    quick, full = make_plan(load_study(name, quick=True)), load_study(name)
    assert 0 < len(quick.runs) < sum(len(list(sweep_settings(sweep))) for sweep in full.spec.all_sweeps)


@pytest.mark.slow
@pytest.mark.parametrize("name", STUDIES)
def test_built_in_study_runs_are_valid(name: str) -> None:
    assert make_plan(load_study(name)).runs


def test_too_large_grid_is_rejected_at_once(write_study):
    """Twenty keys of three values each: three thousand million runs, in twenty lines."""
    keys = ", ".join(f'"units.0.key{number}" = [1, 2, 3]' for number in range(20))
    text = f'scenario = "triangle"\nkeep = ["shape_error"]\ngrid = {{ {keys} }}\n'
    with pytest.raises(InputError, match=r"3\.49e\+09 runs; at most 1000000"):
        make_plan(load_study(str(write_study(text))))
