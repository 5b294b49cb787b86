"""Stored outcomes of a study's runs, and repeated runs."""

from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from study_runs import SMALL, conduct_here

from skyherd.analysis.history import CURVES, make_history
from skyherd.datasets import Mission, load_mission
from skyherd.errors import InputError
from skyherd.loop import run_steps
from skyherd.study import conduct as conducting
from skyherd.study.measure import measure
from skyherd.study.spec import SUMMARY_FIELDS
from skyherd.study.store import PARTS, Store, open_store
from skyherd.study.table import good_rows


@pytest.mark.smoke
def test_measure_matches_recorded_run() -> None:
    mission = load_mission("triangle", ["perception=ideal", "duration_s=1.0"])
    history = make_history(mission, run_steps(mission))
    outcome = measure("k", mission, CURVES)
    assert outcome["error"] is None
    assert outcome["shape_error"] == history.shape_error[-1]
    assert set(outcome) == {"key", "error", *SUMMARY_FIELDS, *(f"history.{name}" for name in CURVES)}
    np.testing.assert_array_equal(outcome["history.positions_m"], history.positions_m)


def test_images_are_released_during_run() -> None:
    mission = load_mission("triangle", ["duration_s=0.3"])
    step = next(run_steps(mission))
    assert step.frames[0].sight.image is not None
    assert step.without_images().frames[0].sight.image is None
    assert step.without_images().frames[0].sight.detections is step.frames[0].sight.detections


# What is kept


def test_table_has_row_per_run_in_order(write_study: Any, without_cluster: None, tmp_path: Path) -> None:
    table, report = conduct_here(write_study(), tmp_path / "out")
    assert report.made == 6
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


def test_changed_study_reruns_only_changes(write_study: Any, without_cluster: None, tmp_path: Path) -> None:
    out = tmp_path / "out"
    first, _ = conduct_here(write_study(), out)
    again, report = conduct_here(write_study(), out)
    assert (report.made, report.reused) == (0, 6)
    assert again.equals(first)
    wider = SMALL.replace("[0.1, 0.3]", "[0.3, 0.2]").replace('"V_end"', '"scale"')
    table, report = conduct_here(write_study(wider), out)
    assert (report.made, report.reused) == (3, 3)
    assert table["shape_error"].to_pylist()[:3] == first["shape_error"].to_pylist()[3:]
    _, report = conduct_here(write_study(), out)  # what a study does not ask for is not thrown away
    assert report.made == 0


def test_curves_are_kept_on_request(write_study: Any, without_cluster: None, tmp_path: Path) -> None:
    out = tmp_path / "out"
    conduct_here(write_study(), out)
    asking = SMALL.replace('"converged"', '"history.times_s", "history.positions_m"')
    table, report = conduct_here(write_study(asking), out)
    assert report.made == 6
    positions_m = np.array(table["history.positions_m"][0].as_py())
    assert positions_m.shape == (5, 6, 2)
    np.testing.assert_allclose(table["history.times_s"][0].as_py(), np.arange(5) * 0.1)
    assert conduct_here(write_study(), out)[1].made == 0


def test_equal_runs_are_made_once(write_study: Any, without_cluster: None, tmp_path: Path) -> None:
    table, report = conduct_here(write_study(SMALL.replace("[0.1, 0.3]", "[0.1, 0.1]")), tmp_path / "out")
    assert report.made == 3
    assert table.slice(0, 3).equals(table.slice(3, 3))


def test_compact_merges_parts_without_loss(tmp_path: Path) -> None:
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


def test_incomplete_part_is_ignored(tmp_path: Path) -> None:
    out = tmp_path / "out"
    with open_store(out, "{}") as store:
        store.append([{"key": "a", "error": None}])
    whole = next((out / PARTS).iterdir()).read_bytes()
    torn = out / PARTS / ".skyherd-0123456789abcdef.part"
    torn.write_bytes(whole[: len(whole) // 2])
    assert Store(out).keys() == {"a"}
    with open_store(out, "{}") as store:
        assert not torn.exists()
        assert store.keys() == {"a"}


def test_damaged_part_is_named(tmp_path: Path) -> None:
    with open_store(tmp_path / "out", "{}") as store:
        store.append([{"key": "a", "error": None}])
        part = next((tmp_path / "out" / PARTS).iterdir())
        part.write_bytes(part.read_bytes()[:-9])
        with pytest.raises(InputError, match=r"00000001\.parquet: damaged.*remove it"):
            store.read()


def test_folder_serves_one_study_at_a_time(tmp_path: Path) -> None:
    out = tmp_path / "out"
    with (
        open_store(out, "{}"),
        pytest.raises(InputError, match=r"`skyherd study` writes into it \(process \d+"),
        open_store(out, "{}"),
    ):
        pass
    with open_store(out, "{}"):
        pass
    (tmp_path / "letters").mkdir()
    (tmp_path / "letters" / "love.txt").write_text("dear")
    with (
        pytest.raises(InputError, match="is not the folder of a study"),
        open_store(tmp_path / "letters", "{}"),
    ):
        pass
    assert [entry.name for entry in (tmp_path / "letters").iterdir()] == ["love.txt"]


def test_failing_run_is_recorded_and_study_continues(
    write_study: Any, without_cluster: None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def run(key: str, mission: Any, curves: Any) -> dict[str, Any]:
        broken = mission.scenario.units[0].yaw_deg == 90 and breaks
        return measure(key, object.__new__(Mission) if broken else mission, curves)

    out, breaks = tmp_path / "out", True
    monkeypatch.setattr(
        conducting, "run_missions", lambda client, missions, curves: ([run(*m, curves)] for m in missions)
    )
    table, report = conduct_here(write_study(), out)
    assert report.made == 6
    failed = [row for row in table.to_pylist() if row["error"]]
    assert [row["units.0.yaw_deg"] for row in failed] == [90.0, 90.0]
    assert all(row["shape_error"] is None and "AttributeError" in row["error"] for row in failed)
    assert len(good_rows(table)) == 4
    assert "2 failed: AttributeError" in (out / "table.md").read_text()
    breaks = False
    assert conduct_here(write_study(), out)[1].made == 0  # the same input fails again
    table, report = conduct_here(write_study(), out, retry=True)
    assert report.made == 2
    assert table["error"].null_count == 6


def _no_columns(part: Path) -> None:
    pq.write_table(pa.table({"x": [1]}), part)


def _keys_of_numbers(part: Path) -> None:
    pq.write_table(pa.table({"key": [1], "error": pa.array([None], pa.string())}), part)


def _no_key(part: Path) -> None:
    pq.write_table(pa.table({"key": pa.array([None], pa.string()), "error": ["x"]}), part)


def _no_parquet(part: Path) -> None:
    part.write_text("hello")


def _empty(part: Path) -> None:
    part.write_bytes(b"")


def _folder(part: Path) -> None:
    part.unlink()
    part.mkdir()


@pytest.mark.parametrize("damage", [_no_columns, _keys_of_numbers, _no_key, _no_parquet, _empty, _folder])
def test_foreign_part_is_rejected(tmp_path: Path, damage: Any) -> None:
    with open_store(tmp_path / "out", "{}") as store:
        store.append([{"key": "a", "error": None}])
        damage(next((tmp_path / "out" / PARTS).iterdir()))
        with pytest.raises(
            InputError, match=r"00000001\.parquet: (damaged|is a folder).*remove it"
        ) as refused:
            store.keys()
    assert "\n" not in str(refused.value) and len(str(refused.value)) < 500


def test_incompatible_parts_are_rejected(tmp_path: Path) -> None:
    with open_store(tmp_path / "out", "{}") as store:
        store.append([{"key": "a", "error": None, "x": 1.0}])
        store.append([{"key": "b", "error": None, "x": "text"}])
        with pytest.raises(InputError, match="do not go together"):
            store.read()


def test_foreign_files_among_parts_are_kept(tmp_path: Path) -> None:
    with open_store(tmp_path / "out", "{}") as store:
        store.append([{"key": "a", "error": None}])
        (tmp_path / "out" / PARTS / "1-mine.parquet").write_text("mine")
        store.append([{"key": "b", "error": None}])
        store.compact()
        assert store.keys() == {"a", "b"}
    assert (tmp_path / "out" / PARTS / "1-mine.parquet").read_text() == "mine"
