"""Formation controllers on the same tasks: outputs from a table, and requirements of the study's file."""

import re
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pytest
from study_runs import conduct_here

from skyherd.errors import InputError
from skyherd.plots.style import drawing_style
from skyherd.study.methods.outcomes import make_methods
from skyherd.study.methods.page import HEAD, glance, markdown
from skyherd.study.methods.paths import draw_paths
from skyherd.study.methods.plots import BOARDS, draw_methods
from skyherd.study.plan import make_plan
from skyherd.study.spec import METHODS_KEEPS, load_study

STUDY = f"""
scenario = "crowd"
keep = {list(METHODS_KEEPS)}
pages = "methods"
tasks_version = 3
set = {{ perception = "ideal", duration_s = 0.4 }}

[[tasks]]
name = "anywhere"
about = "In a crowd."
set = {{ "robots.scatter" = {{ scale_m = 0.001, jitter_m = 2.4, spacing_m = 1.0 }} }}

[[tasks]]
name = "near"
set = {{ robots.scatter.scale_m = 4.0, robots.scatter.jitter_m = 0.2 }}

[[sweeps]]
name = "ours"
about = "images"

[[sweeps]]
name = "theirs"
about = "places"
set = {{ control.method = "complex-laplacian", roles.exchange = false, avoidance.on = false }}
"""
ROOT = Path(__file__).parents[2]


def row(method: str, task: str, **values: Any) -> dict[str, Any]:
    """Return a table row of a run that formed the shape."""
    told = "complex-laplacian" if method == "theirs" else "similarity"
    fields = {
        "reached_s": 10.0,
        "ready_s": 4.0,
        "simulated_s": 60.0,
        "path_length_m": 20.0,
        "min_gap_m": 0.1,
        "collisions": 0,
        "converged": True,
        "shape_error": 0.002,
        "history.affine_error": [0.5, 0.001],
        "history.affine_reached_s": 9.0,
        "history.min_path_m": 16.0,
        "history.waypoints_m": [[[0.0, 0.0], [1.0, 0.0]], [[0.0, 1.0], [1.0, 1.0]]],
        "history.messages_per_robot_s": 5.0,
        "history.numbers_per_robot_s": 10.0,
        "error": None,
    }
    return {"sweep": method, "task": task, "control.method": told, "control.k": 0.6} | fields | values


def some_methods(write_study: Any):
    study = load_study(str(write_study(STUDY)))
    table = pa.Table.from_pylist(
        [
            row("ours", "anywhere"),
            row("ours", "anywhere", reached_s=14.0, ready_s=6.0, collisions=2),
            row("ours", "anywhere", reached_s=15.0, converged=False),
            row("ours", "anywhere", reached_s=None, error="broke"),
            row("theirs", "anywhere"),
            row("ours", "near", ready_s=None),
            row("theirs", "near", reached_s=None, converged=False, shape_error=0.2),
            row("theirs", "near", reached_s=None, converged=False, **{"history.affine_reached_s": np.nan}),
        ]
    )
    return study, make_methods(study, table)


def test_times_count_from_start_of_motion(write_study: Any) -> None:
    """Robots with true positions do not wait for a tree of units."""
    _, (ours, theirs) = some_methods(write_study)
    assert (ours.name, ours.needs, list(ours.outcomes)) == ("ours", "images", ["anywhere", "near"])
    crowded = ours.outcomes["anywhere"]
    np.testing.assert_array_equal(crowded.times_s, [6.0, 8.0, np.nan])
    np.testing.assert_array_equal(crowded.affine_times_s, [5.0, 3.0, 5.0])
    np.testing.assert_array_equal(crowded.collided, [False, True, False])
    assert crowded.failed == 1
    np.testing.assert_array_equal(theirs.outcomes["anywhere"].times_s, [10.0])
    np.testing.assert_array_equal(ours.outcomes["near"].times_s, [10.0])


def test_affine_end_counts_as_affine_only(write_study: Any) -> None:
    study, methods = some_methods(write_study)
    runs = methods[1].outcomes["near"]
    np.testing.assert_array_equal(runs.affine, [True, False])
    assert not runs.converged.any() and np.isnan(runs.times_s).all()
    cells = markdown(study.spec.tasks[1], methods).splitlines()[-1].strip("| ").split(" | ")
    said = dict(zip(HEAD, cells, strict=True))
    assert (said["formed"], said["affine image formed"]) == ("0 of 2", "1 of 2")
    assert (said["time to 1 % (s)"], said["time to 1 % of an affine image (s)"]) == ("–", "9")
    assert (said["path over the shortest"], said["affine error at the end"]) == ("1.25", "0.001")


def test_glance_includes_wait_for_units(write_study: Any) -> None:
    _, (ours, theirs) = some_methods(write_study)
    assert glance(ours, "anywhere") == "2 of 3, 12 s"  # 4 + 6 and 6 + 8
    assert (glance(theirs, "anywhere"), glance(theirs, "near")) == ("1 of 1, 10 s", "0 of 2")


def test_grid_gives_method_per_value(write_study: Any) -> None:
    text = STUDY.replace('about = "images"', 'about = "images"\ngrid = { control.k = [0.6, 1.2] }')
    study = load_study(str(write_study(text)))
    table = pa.Table.from_pylist(
        [row("ours", "near", **{"control.k": k}, path_length_m=10 * k) for k in (0.6, 1.2)]
    )
    first, second, _ = make_methods(study, table)
    assert (first.name, second.name) == ("ours, k = 0.6", "ours, k = 1.2")
    assert (first.outcomes["near"].paths_m, second.outcomes["near"].paths_m) == ([6.0], [12.0])


def test_figure_has_number_or_dash_in_each_cell(write_study: Any) -> None:
    _, methods = some_methods(write_study)
    with drawing_style():
        figure = draw_methods(methods)
        boards = {axes.get_title(): [text.get_text() for text in axes.texts] for axes in figure.axes}
    assert list(boards) == [board.title for board in BOARDS]
    assert boards["formed the shape (%)"] == ["67", "100", "100", "0"]
    assert boards["formed an affine image of it (%)"] == ["100", "100", "100", "50"]
    assert boards["time to 1 % of the shape (s)"] == ["7", "10", "10", "–"]
    assert boards["path over the shortest"] == ["1.25"] * 4


def test_paths_show_first_start_and_outcome(write_study: Any) -> None:
    _, methods = some_methods(write_study)
    bodies = {"radius_m": 0.4, "obstacles": [(0.5, 0.5, 0.3)]}
    with drawing_style():
        figure = draw_paths("near", methods, bodies)
        panels = [axes for axes in figure.axes if axes.get_title()]
        titles = [axes.get_title() for axes in panels]
    assert titles == ["ours\nformed in 10 s", "theirs\naffine image in 9 s"]
    for axes in panels:
        radii = sorted(patch.get_radius() for patch in axes.patches)
        assert radii == [0.3, 0.4, 0.4]
        np.testing.assert_array_equal(axes.lines[0].get_xydata(), [[0.0, 0.0], [0.0, 1.0]])


def test_study_page_is_self_contained(write_study: Any, without_cluster: None, tmp_path: Path) -> None:
    table, _ = conduct_here(write_study(STUDY), tmp_path / "out")
    assert table["task"].to_pylist() == ["anywhere", "near"] * 2
    page = (tmp_path / "out" / "methods.html").read_text("utf-8")
    assert page.count("<table>") == 3 and page.count('src="data:image/png') == 3
    assert "http" not in page.replace("http://www.w3.org", "") and "version 3" in page
    assert "ours" in (tmp_path / "out" / "table.md").read_text("utf-8")


def test_all_methods_have_same_starts() -> None:
    """Seeds are drawn once: run i of every method and task starts with the same robot positions."""
    plan = make_plan(load_study("methods", quick=True))
    starts: dict[str, list[Any]] = {}
    for run in plan.runs:
        starts.setdefault(run.sweep, []).append(plan.mission(run).positions_m)
    first, *others = starts.values()
    assert len(starts) == len(plan.study.spec.sweeps) and len(first) == len(plan.study.spec.tasks)
    for other in others:
        for place, same in zip(first, other, strict=True):
            np.testing.assert_array_equal(place, same)
    places = dict(zip([task.name for task in plan.study.spec.tasks], first, strict=True))
    np.testing.assert_array_equal(places["near"], places["1 cm"])
    np.testing.assert_array_equal(places["near"], places["loss"])


def test_gains_are_tuned_on_separate_starts() -> None:
    gains = Path(__file__).parents[2] / "benchmarks" / "gains.toml"
    spans = [load_study(str(name)).spec.random.draw["seed"].whole for name in ("methods", gains)]
    assert spans[0][1] < spans[1][0]


@pytest.mark.parametrize(
    ("old", "new", "complaint"),
    [
        ("'min_gap_m', ", "", "keep: lacks min_gap_m, which pages = 'methods' needs"),
        (STUDY[STUDY.index("[[sweeps]]") :], "", "a sweep for each method"),
        ("tasks_version = 3\n", "", "tasks_version: missing; a whole number, which tasks need"),
        ('name = "near"', 'name = "anywhere"', "tasks: two tasks have one name; each task its own name"),
        (
            "avoidance.on = false }",
            "robots.scatter.scale_m = 1.0 }",
            "tasks.0.set: robots.scatter.scale_m is given by a sweep",
        ),
        (STUDY[STUDY.index("tasks_version") : STUDY.index("set =")], "", "tasks_version"),
    ],
)
def test_missing_fields_of_pages_are_reported(write_study: Any, old, new, complaint) -> None:
    assert old in STUDY
    with pytest.raises(InputError) as caught:
        load_study(str(write_study(STUDY.replace(old, new))))
    assert complaint in caught.value.lines[0]


def test_documented_user_law_is_compared(
    write_study: Any, without_cluster: None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The law has ten lines at most; it forms the shape from the first start near it."""
    text = (ROOT / "docs" / "methods.md").read_text("utf-8")
    law = re.search(r"```python\n(.*?)```", text, re.S).group(1)
    sweep = re.search(r"```toml\n(.*?)```", text, re.S).group(1)
    assert len(law.split("\n\n")) > 1 and sum(map(bool, law.splitlines())) <= 10
    (tmp_path / "own.py").write_text(law)
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(str(tmp_path))
    whole = (ROOT / "src" / "skyherd" / "study" / "specs" / "methods.toml").read_text("utf-8")
    head, *tasks = whole[: whole.index("[[sweeps]]")].split("[[tasks]]")
    near = next(task for task in tasks if 'name = "near"' in task)
    text = f"{head}[[tasks]]{near}{sweep}".replace("runs = 10", "runs = 2").replace("60.0", "25.0")
    table, report = conduct_here(write_study(text), tmp_path / "mine")
    assert (report.runs, report.failed) == (2, 0)
    assert table["sweep"].to_pylist() == ["my law"] * 2 and table["converged"].to_pylist() == [True] * 2
    assert (tmp_path / "mine" / "methods.html").is_file()
