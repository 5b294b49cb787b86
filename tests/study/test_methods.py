"""Formation controllers on the same starts: what is made of a table, and what the study asks of its file."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pytest
from study_runs import conduct_here

from skyherd.datasets.configuration.robot_models import ScatterModel
from skyherd.errors import InputError
from skyherd.study.methods.outcomes import make_methods
from skyherd.study.methods.page import markdown
from skyherd.study.plan import make_plan
from skyherd.study.spec import load_study

STUDY = """
scenario = "crowd"
keep = ["reached_s", "ready_s", "path_length_m", "min_gap_m", "collisions", "converged"]
pages = "methods"
set = { perception = "ideal", duration_s = 0.4 }

[grid]
"robots.scatter" = [{ scale_m = 0.001, jitter_m = 2.4, spacing_m = 1.0 }, { scale_m = 4.0, jitter_m = 0.2 }]

[[sweeps]]
name = "ours"
about = "images"

[[sweeps]]
name = "theirs"
about = "places"
set = { control.method = "complex-laplacian", roles.exchange = false, avoidance.on = false }
"""
ANYWHERE, NEAR = "anywhere within 2.4 m", "near its place, 4 m a unit"


def row(method: str, start: dict[str, Any], **values: Any) -> dict[str, Any]:
    """A row of the table, where a start is the scenario's, completed by its defaults."""
    told = "complex-laplacian" if method == "theirs" else "similarity"
    fields = {"reached_s": 10.0, "ready_s": 4.0, "path_length_m": 20.0, "min_gap_m": 0.1, "collisions": 0}
    scatter = json.dumps(ScatterModel.model_validate(start).model_dump(mode="json"))
    named = {"sweep": method, "robots.scatter": scatter, "control.method": told}
    return named | fields | {"converged": True, "error": None} | values


def test_times_count_from_when_robots_may_move_and_of_runs_that_formed_the_shape(write_study: Any) -> None:
    """Robots that are told the truth wait for no unit's tree."""
    study = load_study(str(write_study(STUDY)))
    first, second = study.spec.grid["robots.scatter"]
    table = pa.Table.from_pylist(
        [
            row("ours", first),
            row("ours", first, reached_s=14.0, ready_s=6.0, collisions=2),
            row("ours", first, reached_s=15.0, converged=False),
            row("ours", first, reached_s=None, error="broke"),
            row("theirs", first),
            row("ours", second, ready_s=None),
            row("theirs", second, reached_s=None, converged=False),
        ]
    )
    ours, theirs = make_methods(study, table)
    assert (ours.name, ours.needs, list(ours.outcomes)) == ("ours", "images", [ANYWHERE, NEAR])
    crowded = ours.outcomes[ANYWHERE]
    np.testing.assert_array_equal(crowded.times_s, [6.0, 8.0, np.nan])
    np.testing.assert_array_equal(crowded.collided, [False, True, False])
    assert crowded.failed == 1
    np.testing.assert_array_equal(theirs.outcomes[ANYWHERE].times_s, [10.0])
    np.testing.assert_array_equal(ours.outcomes[NEAR].times_s, [10.0])
    assert markdown(ANYWHERE, [ours, theirs]).splitlines()[2:] == [
        "| method | formed | collided | robots wait (s) | time to 1 % (s) | way (m) | least gap (m) |",
        "| --- | --- | --- | --- | --- | --- | --- |",
        "| ours | 2 of 3 | 1 of 3 | 4 (4 to 6) | 7 (6 to 8) | 20 | 0.1 |",
        "| theirs | 1 of 1 | 0 of 1 | 0 | 10 | 20 | 0.1 |",
    ]


def test_the_study_is_run_and_its_page_stands_alone(
    write_study: Any, without_cluster: None, tmp_path: Path
) -> None:
    conduct_here(write_study(STUDY), tmp_path / "out")
    page = (tmp_path / "out" / "methods.html").read_text("utf-8")
    assert page.count("<table>") == 2
    assert 'src="data:image/png' in page and "http" not in page.replace("http://www.w3.org", "")
    assert "ours" in (tmp_path / "out" / "table.md").read_text("utf-8")


def test_the_same_starts_for_all_methods() -> None:
    """Seeds are drawn once: run i of every method begins with the robots in the same places."""
    plan = make_plan(load_study("methods", quick=True))
    starts: dict[str, list[Any]] = {}
    for run in plan.runs:
        starts.setdefault(run.sweep, []).append(plan.mission(run).positions_m)
    first, *others = starts.values()
    assert len(starts) == len(plan.study.spec.sweeps) and len(first) == 8
    for other in others:
        np.testing.assert_array_equal(other, first)
    assert len({place.tobytes() for place in np.array(first)}) == len(first)


@pytest.mark.parametrize(
    ("old", "new", "complaint"),
    [
        ('"min_gap_m", ', "", "keep: pages of methods need min_gap_m too"),
        (STUDY[STUDY.index("[[sweeps]]") :], "", "a sweep for each method"),
        ('"robots.scatter" = [', 'seed = [1, 2]\n"robots.scatter" = [', "robots.scatter alone"),
    ],
)
def test_what_its_pages_need_is_asked_for_in_one_line(write_study: Any, old, new, complaint) -> None:
    with pytest.raises(InputError) as caught:
        load_study(str(write_study(STUDY.replace(old, new))))
    assert complaint in str(caught.value) and "\n" not in str(caught.value)
