"""Studies: what a file means, what is kept, and that no kill at any moment changes the table."""

import contextlib
import json
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import psutil
import pyarrow as pa
import pytest
from PIL import Image

from skyherd.cli import main
from skyherd.datasets import load_mission, make_mission
from skyherd.errors import InputError
from skyherd.history import CURVES, make_history
from skyherd.loop import run_steps
from skyherd.study import conduct as conducting
from skyherd.study.cluster import open_client, run_missions
from skyherd.study.conduct import conduct, missing_runs
from skyherd.study.figures import markdown_table, write_figure_pages
from skyherd.study.measure import measure
from skyherd.study.plan import draw_settings, make_plan, mission_key
from skyherd.study.spec import SUMMARY_FIELDS, RandomModel, StudySpec, load_study, study_names
from skyherd.study.store import PARTS, Store, open_store
from skyherd.study.table import TABLE, good_rows, read_table

SMALL = """
description = "Gains and cameras."
scenario = "triangle"
keep = ["shape_error", "V_end", "converged"]

[set]
perception = "ideal"
duration_s = 0.4

[grid]
control.k = [0.1, 0.3]
units.0.yaw_deg = [0, 90, 180]

[quick.grid]
control.k = [0.1]
"""

SLOW_ENOUGH = """
scenario = "triangle"
keep = ["shape_error", "path_length_m"]
set = { perception = "noisy", duration_s = 6.0 }
random = { runs = 10, seed = 5, draw = { "units.0.yaw_deg" = [-180, 180], seed = { whole = [1, 1000] } } }
"""
"""Ten runs of some tenths of a second, each with its own noise: long enough to be killed in the middle."""


@pytest.fixture
def write(tmp_path: Path) -> Callable[..., Path]:
    """A study file."""

    def make(text: str = SMALL, name: str = "small.toml") -> Path:
        path = tmp_path / name
        path.write_text(text, "utf-8")
        return path

    return make


class Silent:
    """A watcher that counts."""

    def __init__(self) -> None:
        self.missing = self.there = self.made = 0

    def begin(self, missing: int, there: int) -> None:
        self.missing, self.there = missing, there

    def advance_runs(self, outcomes: list[dict[str, Any]]) -> None:
        self.made += len(outcomes)


@pytest.fixture
def here(monkeypatch: pytest.MonkeyPatch) -> None:
    """Runs in this process, one at a time, in place of a cluster."""

    def run(client: Any, missions: Any, curves: Any) -> Iterator[list[dict[str, Any]]]:
        for key, mission in missions:
            yield [measure(key, mission, curves)]

    monkeypatch.setattr(conducting, "open_client", lambda scheduler, jobs: contextlib.nullcontext())
    monkeypatch.setattr(conducting, "run_missions", run)


def conduct_here(path: Path, folder: Path, **options: Any) -> tuple[pa.Table, Silent]:
    watcher = Silent()
    conduct(make_plan(load_study(str(path))), folder, watcher, **options)
    return read_table(folder), watcher


# What a file means


def test_every_combination_of_a_grid_is_run_and_the_last_key_goes_fastest(write: Any) -> None:
    runs = make_plan(load_study(str(write()))).runs
    pairs = [(run.parameters["control.k"], run.parameters["units.0.yaw_deg"]) for run in runs]
    assert pairs == [(k, yaw) for k in (0.1, 0.3) for yaw in (0.0, 90.0, 180.0)]
    assert len({run.key for run in runs}) == 6


def test_a_runs_mission_is_the_one_that_run_would_make(write: Any) -> None:
    plan = make_plan(load_study(str(write())))
    settings = ["perception=ideal", "duration_s=0.4", "control.k=0.3", "units.0.yaw_deg=180"]
    by_hand = load_mission("triangle", settings)
    assert plan.mission(plan.runs[-1]).scenario == by_hand.scenario
    assert plan.runs[-1].key == mission_key(by_hand)


def test_quick_puts_its_keys_over_the_study(write: Any) -> None:
    quick = load_study(str(write()), quick=True)
    assert quick.spec.grid == {"control.k": [0.1], "units.0.yaw_deg": [0, 90, 180]}
    assert len(make_plan(quick).runs) == 3


def test_keys_in_quotes_and_keys_as_tables_mean_the_same() -> None:
    nested = {
        "grid": {"sensor": {"noise": [1.0]}},
        "random": {"runs": 2, "draw": {"marker": {"side_m": [1, 2]}}},
    }
    quoted = {"grid": {"sensor.noise": [1.0]}, "random": {"runs": 2, "draw": {"marker.side_m": [1, 2]}}}
    about = {"scenario": "star", "keep": ["scale"]}
    assert StudySpec.model_validate(about | nested) == StudySpec.model_validate(about | quoted)


def test_a_star_is_every_item_of_a_list(write: Any) -> None:
    text = 'scenario = "star"\nkeep = ["scale"]\n[grid]\n"units.*.height_m" = [20, 25]\n'
    plan = make_plan(load_study(str(write(text))))
    heights = [[unit.height_m for unit in plan.mission(run).scenario.units] for run in plan.runs]
    assert heights == [[20.0] * 3, [25.0] * 3]
    assert [run.parameters["units.*.height_m"] for run in plan.runs] == [20.0, 25.0]


def test_a_sweep_goes_over_the_top_and_is_crossed_with_its_grid(write: Any) -> None:
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
    runs = make_plan(load_study(str(write(text)))).runs
    found = [
        (run.sweep, *(run.parameters[key] for key in ("seed", "control.k", "units.0.yaw_deg")))
        for run in runs
    ]
    yaw = [("yaw", seed, 0.1, turn) for seed in (1, 2) for turn in (0.0, 45.0, 90.0)]
    assert found == [*yaw, ("gain", 1, 0.3, 0.0), ("gain", 2, 0.3, 0.0)]


def test_draws_follow_from_seed_number_and_key_alone() -> None:
    """More runs, more keys or another order change none of the values: what was run need not be run again."""
    some = RandomModel.model_validate({"runs": 2, "seed": 7, "draw": {"a": [0, 1], "b": {"log": [1, 100]}}})
    more = RandomModel.model_validate(
        {"runs": 9, "seed": 7, "draw": {"c": {"whole": [1, 6]}, "b": {"log": [1, 100]}, "a": [0, 1]}}
    )
    for number in range(2):
        fewer, all_keys = draw_settings(some, number), draw_settings(more, number)
        assert fewer == {key: all_keys[key] for key in fewer}
    assert draw_settings(some, 0) != draw_settings(some, 1)
    assert draw_settings(some, 0) != draw_settings(some.model_copy(update={"seed": 8}), 0)


def test_draws_are_distributed_as_the_file_says() -> None:
    """Means of N draws within 5 of their standard deviations: range / sqrt(12 N), or 1 / sqrt(4 N) of two."""
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


def test_the_key_is_of_what_a_run_follows_from(scenario_tree: Any, tmp_path: Path) -> None:
    def key(**changes: Any) -> str:
        return mission_key(make_mission(scenario_tree("triangle") | changes, folder=tmp_path))

    base = key()
    assert key(description="another word") == base
    assert key(seed=2) != base
    assert key(duration_s=119.9) != base
    reordered = dict(reversed(scenario_tree("triangle").items()))
    assert mission_key(make_mission(reordered)) == base


def test_the_key_is_of_what_pictures_show_and_not_of_where_they_lie(
    scenario_tree: Any, tmp_path: Path
) -> None:
    def key(name: str, grey: int) -> str:
        Image.new("L", (64, 64), grey).save(tmp_path / name)
        ground = {"kind": "image", "image": name}
        return mission_key(make_mission(scenario_tree("triangle") | {"ground": ground}, folder=tmp_path))

    assert key("a.png", 90) == key("b.png", 90) != key("c.png", 91)


def test_the_version_is_in_the_key(monkeypatch: pytest.MonkeyPatch) -> None:
    mission = load_mission("triangle")
    before = mission_key(mission)
    monkeypatch.setattr("skyherd.study.plan.__version__", "0.0.0")
    assert mission_key(mission) != before


def test_the_example_in_the_docs_is_good(write: Any) -> None:
    page = Path(__file__).parent.parent / "docs" / "studies.md"
    example = page.read_text("utf-8").split("```toml\n")[1].split("```")[0]
    plan = make_plan(load_study(str(write(example)), quick=True))
    assert len(plan.runs) == 20 * 3 * 1 * 3
    assert {run.sweep for run in plan.runs} == {"tilt"}


@pytest.mark.parametrize("name", study_names())
def test_built_in_studies_are_good_and_have_a_quick_form(name: str) -> None:
    full, quick = make_plan(load_study(name)), make_plan(load_study(name, quick=True))
    assert 0 < len(quick.runs) < len(full.runs)


# One run


def test_a_run_is_measured_as_its_recording_would_be() -> None:
    mission = load_mission("triangle", ["perception=ideal", "duration_s=1.0"])
    history = make_history(mission, run_steps(mission))
    outcome = measure("k", mission, CURVES)
    assert outcome["error"] is None
    assert outcome["shape_error"] == history.shape_error[-1]
    assert set(outcome) == {"key", "error", *SUMMARY_FIELDS, *(f"history.{name}" for name in CURVES)}
    np.testing.assert_array_equal(outcome["history.positions_m"], history.positions_m)


def test_images_are_let_go_as_a_run_goes_on() -> None:
    mission = load_mission("triangle", ["duration_s=0.3"])
    step = next(run_steps(mission))
    assert step.frames[0].sight.image is not None
    assert step.without_images().frames[0].sight.image is None
    assert step.without_images().frames[0].sight.detections is step.frames[0].sight.detections


# What is kept


def test_the_table_has_a_row_a_run_in_the_studys_order(write: Any, here: None, tmp_path: Path) -> None:
    table, watcher = conduct_here(write(), tmp_path / "out")
    assert watcher.made == 6
    assert table.column_names == [
        "control.k",
        "units.0.yaw_deg",
        "shape_error",
        "V_end",
        "converged",
        "error",
        "key",
    ]
    assert table["units.0.yaw_deg"].to_pylist() == [0.0, 90.0, 180.0] * 2
    assert table["error"].null_count == 6
    errors = np.array(table["shape_error"]).reshape(2, 3)
    # Property 1: the camera's yaw changes nothing, the gain does.
    np.testing.assert_allclose(errors, errors[:, :1].repeat(3, axis=1), rtol=1e-9)
    assert abs(errors[0, 0] - errors[1, 0]) > 1e-3


def test_a_changed_study_reruns_only_what_changed(write: Any, here: None, tmp_path: Path) -> None:
    out = tmp_path / "out"
    first, _ = conduct_here(write(), out)
    again, watcher = conduct_here(write(), out)
    assert (watcher.made, watcher.there) == (0, 6)
    assert again.equals(first)
    wider = SMALL.replace("[0.1, 0.3]", "[0.3, 0.2]").replace('"V_end"', '"scale"')
    table, watcher = conduct_here(write(wider), out)
    assert (watcher.made, watcher.there) == (3, 3)
    assert table["shape_error"].to_pylist()[:3] == first["shape_error"].to_pylist()[3:]
    _, watcher = conduct_here(write(), out)  # what a study does not ask for is not thrown away
    assert watcher.made == 0


def test_arrays_over_time_are_kept_on_request_and_made_if_they_are_not_there(
    write: Any, here: None, tmp_path: Path
) -> None:
    out = tmp_path / "out"
    conduct_here(write(), out)
    asking = SMALL.replace('"converged"', '"history.times_s", "history.positions_m"')
    table, watcher = conduct_here(write(asking), out)
    assert watcher.made == 6
    positions_m = np.array(table["history.positions_m"][0].as_py())
    assert positions_m.shape == (5, 6, 2)
    np.testing.assert_allclose(table["history.times_s"][0].as_py(), np.arange(5) * 0.1)
    assert conduct_here(write(), out)[1].made == 0


def test_runs_that_are_alike_are_made_once(write: Any, here: None, tmp_path: Path) -> None:
    table, watcher = conduct_here(write(SMALL.replace("[0.1, 0.3]", "[0.1, 0.1]")), tmp_path / "out")
    assert watcher.made == 3
    assert table.slice(0, 3).equals(table.slice(3, 3))


def test_parts_become_one_and_none_is_lost(tmp_path: Path) -> None:
    with open_store(tmp_path / "out", "{}") as store:
        store.append([{"key": "a", "error": None, "x": 1.0}, {"key": "b", "error": "broke"}])
        store.append([{"key": "b", "error": None, "x": None, "history.y": np.eye(2)}])
        before = store.read().sort_by("key").to_pylist()
        assert [row["error"] for row in before] == [None, None]  # the last outcome counts
        assert store.keys() == {"a", "b"}
        assert store.keys(["history.y"]) == {"b"}
        store.compact()
        assert store.read().sort_by("key").to_pylist() == before
        assert len(list((tmp_path / "out" / PARTS).iterdir())) == 1


def test_a_part_that_was_never_whole_does_not_count(tmp_path: Path) -> None:
    out = tmp_path / "out"
    with open_store(out, "{}") as store:
        store.append([{"key": "a", "error": None}])
    whole = next((out / PARTS).iterdir()).read_bytes()
    torn = out / PARTS / ".00000002.parquet.part"
    torn.write_bytes(whole[: len(whole) // 2])
    assert Store(out).keys() == {"a"}
    with open_store(out, "{}") as store:
        assert not torn.exists()
        assert store.keys() == {"a"}


def test_a_damaged_part_is_named(tmp_path: Path) -> None:
    with open_store(tmp_path / "out", "{}") as store:
        store.append([{"key": "a", "error": None}])
        part = next((tmp_path / "out" / PARTS).iterdir())
        part.write_bytes(part.read_bytes()[:-9])
        with pytest.raises(InputError, match=r"00000001\.parquet: damaged.*remove it"):
            store.read()


def test_a_folder_serves_one_study_at_a_time_and_nothing_else(tmp_path: Path) -> None:
    out = tmp_path / "out"
    with (
        open_store(out, "{}"),
        pytest.raises(InputError, match="another study is at work"),
        open_store(out, "{}"),
    ):
        pass
    with open_store(out, "{}"):
        pass
    (tmp_path / "letters").mkdir()
    (tmp_path / "letters" / "love.txt").write_text("dear")
    with pytest.raises(InputError, match="holds something else"), open_store(tmp_path / "letters", "{}"):
        pass
    assert [entry.name for entry in (tmp_path / "letters").iterdir()] == ["love.txt"]


def test_a_failing_run_is_recorded_and_the_study_goes_on(
    write: Any, here: None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def run(key: str, mission: Any, curves: Any) -> dict[str, Any]:
        broken = mission.scenario.units[0].yaw_deg == 90 and breaks
        return measure(key, None if broken else mission, curves)

    out, breaks = tmp_path / "out", True
    monkeypatch.setattr(
        conducting, "run_missions", lambda client, missions, curves: ([run(*m, curves)] for m in missions)
    )
    table, watcher = conduct_here(write(), out)
    assert watcher.made == 6
    failed = [row for row in table.to_pylist() if row["error"]]
    assert [row["units.0.yaw_deg"] for row in failed] == [90.0, 90.0]
    assert all(row["shape_error"] is None and "AttributeError" in row["error"] for row in failed)
    assert len(good_rows(table)) == 4
    assert "2 failed: AttributeError" in (out / "table.md").read_text()
    breaks = False
    assert conduct_here(write(), out)[1].made == 0  # the same input fails again
    table, watcher = conduct_here(write(), out, retry=True)
    assert watcher.made == 2
    assert table["error"].null_count == 6


# What is made of it


def test_markdown_gives_median_and_range_over_seeds_and_draws() -> None:
    spec = StudySpec.model_validate(
        {
            "scenario": "star",
            "keep": ["shape_error", "converged", "rotation_rad"],
            "grid": {"sensor.noise": [1, 2], "seed": [1, 2, 3]},
        }
    )
    table = pa.table(
        {
            "sensor.noise": [1.0, 1.0, 1.0, 2.0, 2.0],
            "seed": [1, 2, 3, 1, 2],
            "shape_error": [0.1, 0.3, 0.2, 0.5, None],
            "converged": [True, True, False, True, None],
            "rotation_rad": [1.0, 1.0, 1.0, 1.0, None],
            "error": [None, None, None, None, "broke"],
        }
    )
    assert markdown_table(spec, table).splitlines() == [
        "| `sensor.noise` | runs | failed | Shape error | Converged | Rotation (rad) |",
        "| --- | --- | --- | --- | --- | --- |",
        "| 1 | 3 | 0 | 0.2 (0.1 to 0.3) | 2 of 3 | 1 |",
        "| 2 | 2 | 1 | 0.5 | 1 of 1 | 1 |",
    ]


FIGURES = """
[[figures]]
name = "gain"
x = "units.0.yaw_deg"
y = "shape_error"
lines = "control.k"
x_label = "yaw (deg)"
y_log = true
"""


def test_figures_are_drawn_of_what_there_is(write: Any, here: None, tmp_path: Path) -> None:
    path = write(SMALL + FIGURES)
    table, _ = conduct_here(path, tmp_path / "out")
    assert (tmp_path / "out" / "gain.png").read_bytes().startswith(b"\x89PNG")
    none = table.set_column(table.column_names.index("error"), "error", pa.array(["broke"] * 6))
    (tmp_path / "none").mkdir()
    assert [file.name for file in write_figure_pages(load_study(str(path)), none, tmp_path / "none")] == [
        "table.md"
    ]


# From the command line


def call(capsys: Any, *arguments: Any) -> tuple[int, str, str]:
    with pytest.raises(SystemExit) as ended:
        main([str(argument) for argument in arguments])
    said = capsys.readouterr()
    return int(ended.value.code or 0), said.out, said.err


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        (
            '"triangle"',
            '"triangel"',
            ["scenario 'triangel'", "one of chain, circle, failure, grid, star, tree, triangle"],
        ),
        ('"V_end"', '"V_ned"', ["keep", "V_ned", "V_end"]),
        ("[0.1, 0.3]", "0.3", ["grid.control.k", "list", "0.3"]),
        ("[0.1, 0.3]", "[0.1, -3]", ["control.k=-3", "greater than 0", "-3"]),
        ("control.k", "control.kk", ["control.kk", "unknown key"]),
        ("units.0", "units.4", ["units.4.yaw_deg", "0 to 0, or *"]),
        ("[set]", "[sett]", ["sett", "unknown key"]),
        ("duration_s = 0.4", "control.k = 1", ["control.k: give each key once"]),
        ("0.4", "", ["malformed TOML"]),
    ],
)
def test_wrong_studies_are_refused_in_one_line(
    old: str, new: str, words: list[str], write: Any, capsys: Any, tmp_path: Path
) -> None:
    path = write(SMALL.replace(old, new, 1))
    code, _, err = call(capsys, "study", path, "--out", tmp_path / "out")
    assert code == 2
    assert err.count("\n") == 1 and "Traceback" not in err
    for word in [str(path), *words]:
        assert word in err, err
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["nosuch"], "one of noise"),
        (["noise", "--jobs", "0"], "1 or more"),
        (["noise", "--jobs", "2", "--scheduler", "tcp://127.0.0.1:1"], "one of them"),
        (["noise", "--scheduler", "nowhere"], "not an address"),
    ],
)
def test_wrong_arguments_are_refused_in_one_line(
    arguments: list[str], words: str, capsys: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    code, _, err = call(capsys, "study", *arguments)
    assert code == 2
    assert words in err and err.count("\n") == 1


def test_a_dry_run_lists_the_runs_and_leaves_nothing(write: Any, capsys: Any, tmp_path: Path) -> None:
    code, said, _ = call(capsys, "study", write(), "--dry-run", "--out", tmp_path / "out")
    assert code == 0
    assert said.count("to do  control.k=") == 6
    assert "6 runs, 6 to do" in said
    assert not (tmp_path / "out").exists()


def test_built_in_studies_are_listed_and_shown(capsys: Any) -> None:
    assert "noise: " in call(capsys, "study")[1]
    assert "[grid]" in call(capsys, "study", "noise", "--show")[1]
    assert "keep" in json.loads(call(capsys, "study", "--schema")[1])["properties"]


def test_without_the_extra_one_line_says_how_to_get_it(tmp_path: Path) -> None:
    code = "import sys; sys.modules['distributed'] = None; from skyherd.cli import main; main()"
    command = [sys.executable, "-c", code, "study", "noise"]
    ended = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    said = "error: skyherd study: distributed is not installed; pip install 'skyherd[study]'\n"
    assert (ended.returncode, ended.stderr) == (2, said)


# Through Dask


SKYHERD = [sys.executable, "-c", "from skyherd.cli import main; main()"]


def start(path: Path, out: Path, *options: str) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [*SKYHERD, "study", str(path), "--out", str(out), *options],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def finish(path: Path, out: Path, *options: str) -> bytes:
    process = start(path, out, *options)
    _, err = process.communicate(timeout=120)
    assert process.returncode == 0, err
    assert err == ""  # quiet where there is no terminal
    return (out / TABLE).read_bytes()


def parts(out: Path) -> list[Path]:
    return sorted((out / PARTS).glob("*.parquet"))


def wait_for_parts(process: subprocess.Popen[str], out: Path, count: int) -> None:
    """Until so many parts are there and the study is in its middle."""
    ends = time.monotonic() + 90
    while len(parts(out)) < count:
        assert process.poll() is None, process.communicate()
        assert time.monotonic() < ends
        time.sleep(0.02)


def workers(process: subprocess.Popen[str]) -> list[psutil.Process]:
    children = psutil.Process(process.pid).children(recursive=True)
    return [child for child in children if "spawn_main" in " ".join(child.cmdline())]


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """The table of the same study, run one after the other without any cluster."""
    out = tmp_path_factory.mktemp("study")
    path = out / "small.toml"
    path.write_text(SLOW_ENOUGH, "utf-8")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(conducting, "open_client", lambda scheduler, jobs: contextlib.nullcontext())
        patch.setattr(
            conducting,
            "run_missions",
            lambda client, missions, curves: ([measure(*m, curves)] for m in missions),
        )
        conduct_here(path, out / "out")
    return (out / "out" / TABLE).read_bytes()


def test_worker_and_client_killed_in_mid_study_and_resumed_give_the_undisturbed_table(
    write: Any, tmp_path: Path, undisturbed: bytes
) -> None:
    """The table to the byte: a run that was made twice or in another order shows nowhere."""
    path, out = write(SLOW_ENOUGH), tmp_path / "out"
    process = start(path, out, "--jobs", "2")
    wait_for_parts(process, out, 1)
    crew = workers(process)
    assert len(crew) == 2
    crew[0].kill()
    wait_for_parts(process, out, len(parts(out)) + 2)
    process.kill()
    process.communicate()
    kept = len(Store(out).keys())
    assert 3 <= kept < 10
    assert not (out / TABLE).exists()
    psutil.wait_procs(crew, timeout=10)
    assert not any(worker.is_running() and worker.status() != "zombie" for worker in crew)
    assert len(missing_runs(make_plan(load_study(str(path))), Store(out))) == 10 - kept
    assert finish(path, out, "--jobs", "2") == undisturbed


@pytest.fixture
def loopback(tmp_path: Path) -> Iterator[tuple[str, subprocess.Popen[bytes]]]:
    """A scheduler in a process of its own, with one worker: its address, and its process."""
    file = tmp_path / "scheduler.json"
    place = ["--host", "127.0.0.1", "--no-dashboard"]

    def launch(part: str, *options: str) -> subprocess.Popen[bytes]:
        command = [sys.executable, "-m", f"distributed.cli.dask_{part}", *options, *place]
        return subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)

    processes = [launch("scheduler", "--port", "0", "--scheduler-file", str(file))]
    try:
        while not (file.exists() and file.read_text().endswith("}")):
            assert processes[0].poll() is None
            time.sleep(0.05)
        address = json.loads(file.read_text())["address"]
        processes.append(launch("worker", address, "--nthreads", "1", "--no-nanny"))
        yield address, processes[0]
    finally:
        for process in processes:
            process.kill()
            process.wait()


@pytest.mark.slow
def test_a_second_process_as_scheduler_serves_the_same_study(
    write: Any, tmp_path: Path, undisturbed: bytes, loopback: Any
) -> None:
    address, _ = loopback
    assert finish(write(SLOW_ENOUGH), tmp_path / "out", "--scheduler", address) == undisturbed


@pytest.mark.slow
def test_a_scheduler_that_goes_is_told_in_one_line_and_what_was_made_is_kept(
    write: Any, tmp_path: Path, loopback: Any
) -> None:
    address, scheduler = loopback
    path, out = write(SLOW_ENOUGH), tmp_path / "out"
    process = start(path, out, "--scheduler", address)
    wait_for_parts(process, out, 1)
    scheduler.kill()
    _, err = process.communicate(timeout=60)
    assert (process.returncode, err) == (
        2,
        "error: the scheduler is gone; the same command goes on from here\n",
    )
    assert Store(out).keys()


@pytest.mark.slow
def test_a_run_that_kills_its_workers_is_recorded_and_the_others_are_made(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A run's key stands in for the run: Python that the worker carries out."""
    monkeypatch.setattr("skyherd.study.cluster.measure", eval)
    bad = "__import__('os')._exit(1)"
    good = [f"dict(key={number}, error=None)" for number in range(6)]
    with open_client(jobs=2) as client:
        missions: Any = ((text, {}) for text in [bad, *good])
        batches: Any = run_missions(client, missions, {})  # type: ignore[arg-type]
        outcomes = {outcome["key"]: outcome["error"] for batch in batches for outcome in batch}
    assert "died" in outcomes.pop(bad)
    assert outcomes == dict.fromkeys(range(6))


@pytest.mark.slow
def test_an_interrupt_leaves_a_whole_folder(write: Any, tmp_path: Path) -> None:
    path, out = write(SLOW_ENOUGH.replace("6.0", "20.0")), tmp_path / "out"
    process = start(path, out, "--jobs", "2")
    wait_for_parts(process, out, 1)
    process.send_signal(signal.SIGINT)
    _, err = process.communicate(timeout=60)
    assert process.returncode == 130
    assert err.count("\n") == 1 and "goes on from here" in err
    assert len(Store(out).keys()) >= 1
    assert not (out / TABLE).exists()
    assert not list((out / PARTS).glob(".*"))
