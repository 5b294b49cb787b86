"""Report of a live run: its values against known times, and damaged files."""

import json
import re
import shutil

import numpy as np
import pytest
from command_line import call
from live_sessions import BEGUN_S, Script, small_lab

from skyherd.errors import InputError
from skyherd.live.logs.process_log import ProcessLog
from skyherd.live.review import figures, make_live_report
from skyherd.live.review.latency import latency_stages, whole_way
from skyherd.live.review.page import summarize_session
from skyherd.live.review.reasons import armed_stretches, gist, stretches
from skyherd.live.review.session_history import clock_of, read_session

KNOWN_S = 2e-4
"""Uncertainty of the clocks of a `Script`, s. Derived: comparisons every 0.2 s with a drift of 2e-4 s/s, and
time stamps with a resolution of 2.4e-7 s."""


@pytest.fixture(scope="module")
def script():
    return Script(clock_offset_s=7.5)


@pytest.fixture(scope="module")
def folder(script, tmp_path_factory):
    return script.write(tmp_path_factory.mktemp("live") / "run")


@pytest.fixture(scope="module")
def session(folder):
    return read_session(folder)


@pytest.fixture
def few_figures(monkeypatch):
    """Replace all figures by a small one."""
    from skyherd.live.review import page

    monkeypatch.setattr(page, "PANELS", [panel for panel in figures.PANELS if panel.name == "news_age"])


def test_stage_durations_are_exact_despite_clock_offsets(script, session) -> None:
    found = {stage.key: stage for stage in latency_stages(session)}
    names = ("arrival", "wait", "detection", "decision")
    wanted = {name: script.stages_s[:, column] for column, name in enumerate(names)}
    wanted |= {"radio": script.radio_s.T.ravel(), "command": script.command_s.T.ravel()}
    wanted["whole"] = (script.commanded_s - script.captured_s[:, None]).T.ravel()
    assert list(found) == [*wanted]
    for key, times_s in wanted.items():
        np.testing.assert_allclose(found[key].times_s, times_s, atol=KNOWN_S, err_msg=key)
        assert found[key].median_s == pytest.approx(np.median(times_s), abs=KNOWN_S)
        assert found[key].p99_s == pytest.approx(np.percentile(times_s, 99), abs=KNOWN_S)


def test_processes_share_one_time_axis(script, session) -> None:
    ((name, times_s, ages_s),) = whole_way(session)
    assert name == "unit/0"
    np.testing.assert_allclose(times_s, (script.commanded_s - BEGUN_S).T.ravel(), atol=0.05 + KNOWN_S)
    np.testing.assert_allclose(
        ages_s, (script.commanded_s - script.captured_s[:, None]).T.ravel(), atol=KNOWN_S
    )
    robot = session.runs["robot/1"][0]
    known = clock_of(robot, "unit/0")
    assert known.offset_s == pytest.approx(-script.clock_offset_s, abs=KNOWN_S)
    assert 0 <= known.uncertainty_s < KNOWN_S
    assert clock_of(robot, "unit/5").uncertainty_s == np.inf
    (unit,) = session.runs["unit/0"]
    times = [session.times_s(log, [log.stages[0].sent_s if log.is_unit else log.decided[0].time_s])[0]
             for log in (unit, robot)]  # fmt: skip
    assert times[1] - times[0] == pytest.approx(script.radio_s[0, 1] + script.command_s[0, 1], abs=KNOWN_S)


def test_goal_by_uncompared_clock_is_not_counted(tmp_path) -> None:
    script = Script(images=5, clock_offset_s=300.0, compared=False)
    found = {stage.key: stage for stage in latency_stages(read_session(script.write(tmp_path / "run")))}
    assert found["whole"].times_s.size == 0 and found["detection"].times_s.size == 5
    assert np.isnan(found["whole"].median_s)


def test_summary_counts_all_records(script, session) -> None:
    summary = summarize_session(session)
    errors = 0.5 * 0.9 ** np.arange(script.images)
    # A second has six images, or five if the detection of its first image took longer.
    assert summary["shape_error"]["unit/0"] in [pytest.approx(np.median(errors[-n:])) for n in (5, 6)]
    assert summary["images"] == 40 and summary["decisions"] == 120
    assert summary["refused"] == 3 and summary["restarts"] == 0
    assert summary["driving_share"] == 1.0
    assert "recording" not in summary
    assert summary["recorded_s"] == pytest.approx(script.commanded_s.max() - BEGUN_S, abs=0.01)


class TestReasons:
    def test_stretches_follow_the_reasons(self, tmp_path) -> None:
        reasons = ["disarmed"] * 10 + [
            "unit/0 tells of an image 2.3 s ago",
            "unit/0 tells of an image 4 s ago",
        ]
        script = Script(images=20, reasons={1: [*reasons, *["driving"] * 8]})
        session = read_session(script.write(tmp_path / "run"))
        (log,) = session.runs["robot/1"]
        at_s = script.commanded_s[:, 1] - session.zero_s
        found = stretches(session, log)
        assert [one.reason for one in found] == ["disarmed", "unit/0 tells of an image … s ago", "driving"]
        np.testing.assert_allclose([one.start_s for one in found], at_s[[0, 10, 12]], atol=KNOWN_S)
        np.testing.assert_allclose(
            [one.length_s for one in found[:2]], at_s[[10, 12]] - at_s[[0, 10]], atol=KNOWN_S
        )
        (armed,) = armed_stretches(session, log)
        assert armed.start_s == pytest.approx(at_s[12], abs=KNOWN_S)
        assert summarize_session(session)["driving_share"] == pytest.approx((2 * 20 + 8) / 60, abs=0.02)

    def test_unit_without_images_has_a_gap(self, tmp_path) -> None:
        session = read_session(Script(images=12, pause_s=5.0).write(tmp_path / "run"))
        found = stretches(session, session.runs["unit/0"][0])
        assert [one.reason for one in found] == ["decides on images"] * 2
        assert found[0].start_s + found[0].length_s < found[1].start_s - 4.0

    @pytest.mark.parametrize(
        ("reason", "short"),
        [
            ("driving", "driving"),
            ("clock of unit/12 is +2.1e+03 s off, more than 1 s",
             "clock of unit/12 is … s off, more than … s"),
            ("its own clock jumped by -0.5 s between two decisions", "its own clock jumped by … s between two"
             " decisions"),
        ],
    )  # fmt: skip
    def test_reasons_that_differ_only_in_numbers_are_equal(self, reason, short) -> None:
        assert gist(reason) == short


def test_restarted_process_has_one_row(script, folder, tmp_path) -> None:
    shutil.copytree(folder, tmp_path / "run")
    later = Script(lab=script.lab, images=5, clock_offset_s=7.5, first_s=20.0)
    later.write(tmp_path / "later")
    (tmp_path / "later" / "robot_2.mcap").rename(tmp_path / "run" / "robot_2.1.mcap")
    session = read_session(tmp_path / "run")
    first, second = session.runs["robot/2"]
    assert first.times_s[1] < second.times_s[0] and len(second.decided) == later.images
    assert session.restarts == 1 and not session.flaws
    assert session.end_s == pytest.approx(20.0 + 0.8, abs=0.2)


class TestDamagedFiles:
    def test_damaged_or_missing_files_are_one_line(self, folder, tmp_path, capsys, few_figures) -> None:
        run = tmp_path / "run"
        shutil.copytree(folder, run)
        cut = (run / "robot_0.mcap").read_bytes()
        (run / "robot_0.mcap").write_bytes(cut[: len(cut) * 2 // 3])
        bent = bytearray((run / "unit_0.mcap").read_bytes())
        bent[len(bent) // 2] ^= 0xFF
        (run / "unit_0.mcap").write_bytes(bent)
        (run / "robot_1.mcap").write_bytes(b"no recording at all")
        (run / "robot_2.mcap").unlink()
        code, out, err = call(capsys, "report", run)
        assert code == 0 and out.strip() == f"see {run / 'report.html'}"
        assert len(err.strip().splitlines()) == 1
        for words in ("robot_0.mcap: cut short", "unit_0.mcap: ",
                      "robot_1.mcap: no readable record of a live process",
                      "no recording of robot/1, robot/2"):  # fmt: skip
            assert words in err
        summary = json.loads((run / "summary.json").read_text())
        assert 0 < summary["decisions"] < 40 and 0 < summary["images"] < 40
        assert summary["recording"] in (run / "report.html").read_text().replace("&#39;", "'")

    def test_unreadable_folder_is_refused_and_unchanged(self, tmp_path, capsys) -> None:
        run = tmp_path / "run"
        run.mkdir()
        (run / "unit_0.mcap").write_bytes(b"")
        code, out, err = call(capsys, "report", run)
        assert code == 2 and not out and len(err.strip().splitlines()) == 1
        assert "no readable recording" in err
        assert [path.name for path in run.iterdir()] == ["unit_0.mcap"]
        with pytest.raises(InputError, match="no recordings of units or robots"):
            read_session(tmp_path)

    def test_malformed_record_ends_only_its_file(self, script, folder, tmp_path) -> None:
        run = tmp_path / "run"
        shutil.copytree(folder, run)
        for number, (topic, record) in enumerate(
            [
                ("/decide", {"order": {"reason": "x", "v_mps": "fast", "omega_radps": 0.0}, "armed": False}),
                ("/view", {"captured_s": 0.0}),
                (
                    "/heard",
                    {"kind": "goals", "sender": "unit/0", "sent_s": 0.0, "received_s": 1.0, "body": {}},
                ),
                ("/tell", {"line": "later"}),
            ]
        ):
            with ProcessLog(run / f"robot_0.{number}.mcap", "robot/0", script.lab, BEGUN_S) as process_log:
                process_log.put("/tell", BEGUN_S + 1.0, {"line": "before"})
                process_log.put(topic, BEGUN_S if number < 3 else float("nan"), record | {"now_s": 1e300})
                process_log.put("/end", BEGUN_S + 2.0, {})
        session = read_session(run)
        assert len(session.runs["robot/0"]) == 5
        assert sum("do not have this version's format" in flaw for flaw in session.flaws) == 4
        assert [line for log in session.runs["robot/0"] for _, line in log.lines] == ["before"] * 4

    def test_file_of_another_lab_is_ignored(self, script, folder, tmp_path) -> None:
        run = tmp_path / "run"
        shutil.copytree(folder, run)
        with ProcessLog(run / "robot_7.mcap", "robot/0", small_lab(robots=5), BEGUN_S) as process_log:
            process_log.put("/end", BEGUN_S, {})
        session = read_session(run)
        assert session.flaws == ["robot_7.mcap: of another lab, left out"]
        assert len(session.runs["robot/0"]) == 1


class TestPage:
    def test_text_from_files_is_escaped(self, script, tmp_path, few_figures) -> None:
        hostile = "<script>alert('$x')</script>\x1b[2J"
        made = Script(images=6, reasons={0: [hostile] * 6})
        run = made.write(tmp_path / "run")
        with ProcessLog(run / "robot_0.1.mcap", "robot/0", made.lab, BEGUN_S + 3) as process_log:
            process_log.put("/tell", BEGUN_S + 3, {"line": hostile})
            process_log.put("/heartbeat", BEGUN_S + 4, {"refused": {hostile: 2}, "dropped": 0})
        make_live_report(run)
        text = (run / "report.html").read_text()
        assert "<script" not in text and "\x1b" not in text and "&lt;script" in text
        assert not re.search(r"(src|href)=\"(?!data:)", text)

    def test_page_has_every_figure(self, folder, tmp_path) -> None:
        run = tmp_path / "run"
        shutil.copytree(folder, run)
        make_live_report(run)
        text = (run / "report.html").read_text()
        assert text.count("<img") == len(figures.PANELS)
        assert "All 4 recordings are complete" in text

    def test_page_is_reproducible_and_replaces_no_other_file(self, folder, tmp_path, few_figures) -> None:
        run = tmp_path / "run"
        shutil.copytree(folder, run)
        make_live_report(run)
        text = (run / "report.html").read_text()
        make_live_report(run)
        assert (run / "report.html").read_text() == text
        (run / "summary.json").write_text("mine")
        with pytest.raises(InputError, match="was changed since skyherd made it"):
            make_live_report(run)

    def test_figures_without_data_are_omitted(self, folder, tmp_path) -> None:
        run = tmp_path / "run"
        run.mkdir()
        shutil.copy(folder / "robot_1.mcap", run)
        session = read_session(run)
        drawn = {panel.name: panel.draw(session) for panel in figures.PANELS}
        assert {name for name, figure in drawn.items() if figure is None} == {
            "shape_error",
            "images",
            "clocks",
        }
        assert session.flaws == ["no recording of unit/0, robot/0, robot/2"]


def test_decimated_curve_keeps_its_peaks() -> None:
    values = np.zeros(10_000)
    values[777] = 5.0
    times_s, few = figures._few(np.arange(10_000.0), values)
    assert few.size == figures.MAX_POINTS == times_s.size and few.max() == 5.0
