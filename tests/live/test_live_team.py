"""Whole live teams in memory and in simulated time: convergence, faults, recording and replay."""

import re
import time
from dataclasses import replace

import numpy as np
import pytest
from five_markers import cubes, five_markers
from live_processes import PATIENCE_S
from PIL import Image

from skyherd.control.robots.motion_check import STANDS, STRAYS
from skyherd.datasets import make_mission
from skyherd.errors import InputError
from skyherd.live.lab import Lab, load_lab, make_lab
from skyherd.live.live_clock import LiveClock
from skyherd.live.logs.process_log import ProcessLog
from skyherd.live.logs.process_log_file import read_process_log
from skyherd.live.logs.replay import replay
from skyherd.live.mailbox import Air
from skyherd.live.process_context import ProcessContext
from skyherd.live.robot_process import run_robot
from skyherd.live.unit_process import UnitAtWork, run_unit
from skyherd.loop import run_steps
from skyherd.recording.mcap_log import McapLog
from skyherd.vision import DeferringDetector


@pytest.fixture(scope="module")
def faults(load_benchmark):
    return load_benchmark("live_faults")


def team_lab() -> Lab:
    return load_lab("triangle", ["control.k=0.3", "control.k_omega=1.2"])


def team_of(faults, seed=0):
    return faults.Team(team_lab(), [], seed)


def recorded(team, tmp_path):
    """Return recordings of the unit and of robot 3, written like those of the processes."""
    process_logs = {}
    for name in ("unit/0", "robot/3"):
        process = team.processes[name]
        process_log = process_logs[name] = ProcessLog(
            tmp_path / f"{name.replace('/', '_')}.mcap", name, team.lab, team.now_s
        )
        wrap(process, process_log)
    return process_logs


def wrap(process, process_log):
    core, fetch, heartbeat = process.core, process.mailbox.fetch, process.core.heartbeat

    def fetch_and_keep(timeout_s=0.0):
        for arrival in fetch(timeout_s):
            process_log.heard(arrival)
            yield arrival

    def heartbeat_and_keep(now_s, *state):
        process_log.put("/heartbeat", now_s, {})
        return heartbeat(now_s, *state)

    process.mailbox.fetch, core.heartbeat = fetch_and_keep, heartbeat_and_keep
    if process.name.startswith("robot"):
        decide = core.decide

        def decide_and_keep(now_s):
            order = decide(now_s)
            process_log.put("/decide", now_s, {"order": order, "trouble": None})
            return order

        core.decide = decide_and_keep
    else:
        see = core.see

        def see_and_keep(detections, now_s):
            process_log.saw(detections, now_s)
            news = see(detections, now_s)
            process_log.put("/sent", now_s, {"messages": None if news is None else news.messages})
            return news

        core.see = see_and_keep


def test_team_with_message_loss_forms_shape_and_replays_exactly(faults, tmp_path) -> None:
    """Clocks differ by up to 0.8 s, 10 % of the messages are lost, and 10 % have a latency of 0.2 s."""
    rng = np.random.default_rng(2)
    team = team_of(faults)
    for process in team.processes.values():
        process.offset_s = float(rng.uniform(-0.4, 0.4))
    team.air.drop = lambda topic, receiver: bool(rng.random() < 0.1)
    team.air.delay_s = lambda topic, receiver: 0.2 * float(rng.random() < 0.1)
    process_logs = recorded(team, tmp_path)
    start_error = None
    for _ in range(110):
        team.step()
        start_error = start_error or team.errors[0]
    assert team.errors[-1] < 0.25 * start_error
    assert max(team.blind_s.values()) <= team.lab.model.limits.goal_timeout_s + 2 * faults.PERIOD_S
    for process_log in process_logs.values():
        process_log.__exit__(None, None, None)
    robot, unit = replay(tmp_path / "robot_3.mcap"), replay(tmp_path / "unit_0.mcap")
    assert (robot.different, unit.different) == (0, 0)
    assert robot.decisions == 110 and unit.decisions == 110


def fixed_lab(driver: str = "world", **control) -> Lab:
    """Return the lab `triangle` under a camera that does not fly."""
    tree = team_lab().model.model_dump(mode="json")
    tree["cameras"][0]["flight"] = None
    tree["robots"] = [robot | {"driver": driver} for robot in tree["robots"]]
    return make_lab(tree | {"control": tree["control"] | control})


def accused(faults, lab: Lab, driven: dict[int, int], seconds: float = 25.0) -> dict[int, str]:
    """Drive a team, and return the last words of the robots that were disarmed for their motion."""
    team = faults.Team(lab, [], 0)
    team.driven = driven
    while team.time_s < seconds:
        team.step()
    told = {robot: " ".join(team.processes[f"robot/{robot}"].told) for robot in lab.ids}
    return {robot: fault for robot, words in told.items() for fault in (STRAYS, STANDS) if fault in words}


RIGHT = {robot: robot for robot in range(6)}
ALL_BUT_2 = {robot: robot for robot in RIGHT if robot != 2}


class LateTeam:
    """A team under a fixed camera whose stream has no clock, from an arm command on.

    Args:
        faults: the benchmark of faults.
        delay_s: delay of the images.
    """

    def __init__(self, faults, delay_s: float) -> None:
        self.team = faults.Team(fixed_lab(), [], 1)
        self.team.delay_s = delay_s
        self.unit = self.team.processes["unit/0"]

    def run(self, seconds: float) -> float:
        """Return the longest way of a robot in a time, marker sides."""
        end_s, ways_m = self.team.time_s + seconds, 0.0
        while self.team.time_s < end_s:
            before_m = self.team.world.positions_m.copy()
            self.team.step()
            ways_m = ways_m + np.linalg.norm(self.team.world.positions_m - before_m, axis=1)
        return float(np.max(ways_m)) / self.team.lab.model.markers.side_m


class TestLateImages:
    def test_unit_latches_and_names_the_delay(self, faults) -> None:
        late = LateTeam(faults, 2.0)
        late.run(15.0)
        first, second, third = late.unit.told
        assert "may be frozen" in first
        assert re.search(r"images are late: they follow the commands after about (1\.[6-9]|2\.\d) s", second)
        assert "suspected 3 times" in third and "stop the team and arm it again" in third
        assert late.run(10.0) == 0.0

    def test_stop_and_arm_command_let_the_team_drive_again(self, faults) -> None:
        late = LateTeam(faults, 2.0)
        late.run(15.0)
        late.team.armed_s = late.team.time_s  # without a stop
        assert late.run(4.0) == 0.0
        late.team.delay_s = 0.0
        late.team.stop()
        assert late.run(1.0) == 0.0
        late.team.armed_s = late.team.time_s
        assert late.run(10.0) > 1.0
        assert late.team.errors[-1] < 0.05 and late.unit.core.trouble == ""

    def test_usual_latency_is_no_fault(self, faults) -> None:
        late = LateTeam(faults, 0.3)
        late.run(15.0)
        assert late.unit.told == [] and late.team.errors[-1] < 0.05


class TestMotion:
    """Robots, units, their messages and the lab, from images to wheels."""

    def test_exchanged_drivers_are_found_and_no_other_robot(self, faults) -> None:
        assert accused(faults, fixed_lab(), RIGHT | {0: 4, 4: 0}) == {0: STRAYS, 4: STRAYS}

    @pytest.mark.parametrize("lab", [fixed_lab(), team_lab()], ids=["fixed", "flying"])
    def test_right_robots_are_not_accused(self, faults, lab) -> None:
        assert accused(faults, lab, RIGHT) == {}

    def test_driver_that_turns_no_wheel_of_the_team_is_found(self, faults) -> None:
        """Its robot stands, and another one may drive where no unit looks."""
        assert accused(faults, fixed_lab(k=2.0), ALL_BUT_2) == {2: STANDS}

    def test_no_check_without_wheels_or_against_the_lab(self, faults, monkeypatch) -> None:
        """The negative control is the test above."""
        assert accused(faults, fixed_lab("dry-run", k=2.0), ALL_BUT_2) == {}
        assert accused(faults, fixed_lab(k=2.0, motion_check=False), ALL_BUT_2) == {}
        make_robot = Lab.make_robot
        monkeypatch.setattr(Lab, "make_robot", lambda lab, robot: make_robot(lab, robot, dry_run=True))
        assert accused(faults, fixed_lab(k=2.0), ALL_BUT_2) == {}


@pytest.mark.parametrize("dry_run", [False, True])
def test_dry_run_reaches_the_robot_and_its_replay(tmp_path, monkeypatch, dry_run) -> None:
    made, make_robot = [], Lab.make_robot

    def make_and_note(lab, robot_id, **options):
        made.append(options["dry_run"])
        return make_robot(lab, robot_id, **options)

    monkeypatch.setattr(Lab, "make_robot", make_and_note)
    ended = iter([False, True])
    context = replace(context_of(tmp_path, lambda line: None, lambda: next(ended)), dry_run=dry_run)
    run_robot(context, 3)
    replay(tmp_path / "robot_3.mcap")
    assert made == [dry_run, dry_run]


def test_replay_detects_a_changed_message(faults, tmp_path, monkeypatch) -> None:
    team = team_of(faults)
    process_logs = recorded(team, tmp_path)
    process_log = process_logs["robot/3"]
    put = ProcessLog.keep
    heard = []

    def put_changed(self, topic, now_s, record):
        if topic == "/heard" and record["kind"] == "goals" and self is process_log:
            heard.append(record)
            if len(heard) == 25:
                record = record | {"received_s": record["received_s"] + 5.0}
        put(self, topic, now_s, record)

    monkeypatch.setattr(ProcessLog, "keep", put_changed)
    for _ in range(45):
        team.step()
    for kept in process_logs.values():
        kept.__exit__(None, None, None)
    assert len(heard) > 30
    assert replay(tmp_path / "robot_3.mcap").different > 0


def test_team_stops_in_partition_and_resumes_after_it(faults) -> None:
    team = team_of(faults, seed=1)
    speeds = []
    for _ in range(90):
        team.air.drop = lambda topic, receiver: 4.0 <= team.time_s < 7.0
        team.step()
        speeds.append(max(abs(v) + abs(w) for v, w, _ in team.wheels.values()))
    limit = round((4.0 + team.lab.model.limits.goal_timeout_s) / faults.PERIOD_S) + 2
    assert max(speeds[30:40]) > 0 and max(speeds[limit:70]) == 0 and max(speeds[78:]) > 0


@pytest.mark.parametrize(
    "fault",
    [
        "clock 20 s off",
        "garbage",
        *(
            pytest.param(fault, marks=pytest.mark.slow)
            for fault in ("two teams", "robot killed", "unit killed", "stream repeats", "clock set by 20 s")
        ),
    ],
)
def test_wheels_stop_in_time_under_each_fault(faults, fault) -> None:
    row = faults.run(fault, 3, duration_s=faults.DURATION_S if fault == "clock set by 20 s" else 6.0)
    assert not row["exceeded"]
    if "clock" in fault:
        assert any("s off, more than" in line for line in row["told"])
    if fault == "clock 20 s off":
        assert row["blind_s"] == 0  # The clock is wrong from the start, so that no robot moves.
    if fault in ("two teams", "garbage"):
        assert row["refused"] > 10 and row["blind_s"] > 0


class TestProcessLog:
    def test_full_disk_ends_recording_without_error(self, tmp_path, monkeypatch) -> None:
        lab = load_lab("triangle")
        with ProcessLog(tmp_path / "a.mcap", "robot/3", lab, 0.0) as process_log:
            process_log.put("/tell", 0.1, {"line": "before"})

            def full(*arguments):
                raise OSError(28, "No space left on device")

            monkeypatch.setattr(process_log._log, "flush", full)
            process_log.put("/tell", 5.0, {"line": "after"})
            assert "No space left" in process_log.trouble
            process_log.put("/tell", 6.0, {"line": "later"})

    def test_truncated_file_reads_up_to_last_chunk(self, tmp_path) -> None:
        lab = load_lab("triangle")
        path = tmp_path / "a.mcap"
        with ProcessLog(path, "robot/3", lab, 0.0) as process_log:
            for step in range(100):
                process_log.put("/tell", step * 0.1, {"line": str(step)})
            data = path.read_bytes()
        (tmp_path / "cut.mcap").write_bytes(data[:-5])
        lines = [
            record["line"] for topic, record in read_process_log(tmp_path / "cut.mcap") if topic == "/tell"
        ]
        assert lines == [str(step) for step in range(len(lines))] and len(lines) >= 90

    def test_damaged_file_reads_up_to_first_missing_record(self, tmp_path) -> None:
        """A replay of later records would lack inputs, and its decisions would differ."""
        path = tmp_path / "a.mcap"
        with ProcessLog(path, "robot/3", load_lab("triangle"), 0.0) as process_log:
            for step in range(100):
                process_log.put("/tell", step * 0.1, {"line": str(step)})
        data = bytearray(path.read_bytes())
        chunks = [found.end() for found in re.finditer(b"zstd", data)]
        data[chunks[8] + 30] ^= 0xFF
        path.write_bytes(data)
        lines = [record["line"] for topic, record in read_process_log(path) if topic == "/tell"]
        assert lines == [str(step) for step in range(len(lines))] and 10 < len(lines) < 90

    @pytest.mark.parametrize("content", [b"", b"no MCAP at all, whatever it is"])
    def test_other_file_is_refused_in_one_line(self, tmp_path, content) -> None:
        path = tmp_path / "robot_1.mcap"
        path.write_bytes(content)
        with pytest.raises(InputError, match=r"robot_1\.mcap"):
            replay(path)


def test_arm_and_stop_repeat_until_all_robots_confirm(faults) -> None:
    """The operator's own loop runs while time advances in `listen`. 30 % of the messages are lost."""
    from skyherd.live import operator

    team = team_of(faults, seed=2)
    team.armed_s = None
    for _ in range(10):
        team.step()
    rng = np.random.default_rng(0)
    team.air.drop = lambda topic, receiver: bool(rng.random() < 0.3)
    watched = operator.watch(team.lab, team.air.radio("desk"), lambda: team.now_s, "desk")
    listen = watched.listen

    def listen_and_step(timeout_s):
        team.step()
        listen(0.0)

    watched.listen = listen_and_step
    assert operator.arm(team.lab, watched, settle_s=60.0).missing == {}
    assert operator.stop(team.lab, watched, "test", settle_s=60.0).missing == {}
    assert not any(p.core.armed for name, p in team.processes.items() if name.startswith("robot"))


def context_of(folder, say, ended):
    """Return a context of unit 0 of the lab `triangle` with a radio in memory. It ends by `PATIENCE_S`."""
    latest_s = time.monotonic() + PATIENCE_S
    return ProcessContext(
        load_lab("triangle"),
        Air().radio("unit/0"),
        LiveClock(),
        folder,
        say,
        lambda: ended() or time.monotonic() > latest_s,
    )


class TestUnitProcess:
    def test_full_disk_is_reported_and_unit_continues(self, tmp_path, monkeypatch) -> None:
        images, lines = tmp_path / "images", []
        images.mkdir()
        for number in range(3):
            Image.fromarray(np.full((120, 160), 90, np.uint8)).save(images / f"{number}.png")

        def full(*arguments):
            raise OSError(28, "No space left on device")

        context = context_of(tmp_path / "run", lines.append, lambda: any("device" in line for line in lines))
        put = McapLog.put
        monkeypatch.setattr(
            McapLog, "put", lambda log, topic, *rest: put(log, topic, *rest) if topic == "/about" else full()
        )
        run_unit(context, 0, address=str(images))
        assert any("No space left on device; recording has ended" in line for line in lines)

    def test_deferred_search_follows_sending(self, tmp_path, monkeypatch) -> None:
        images, order = tmp_path / "images", []
        images.mkdir()
        Image.fromarray(np.full((120, 160), 90, np.uint8)).save(images / "0.png")
        look, report = UnitAtWork.look, UnitAtWork.report
        monkeypatch.setattr(UnitAtWork, "look", lambda *given: order.append("looked") or look(*given))
        monkeypatch.setattr(UnitAtWork, "report", lambda *given: order.append("reported") or report(*given))
        monkeypatch.setattr(
            DeferringDetector, "look_around", lambda own, image, *, unit_id: order.append(int(image[0, 0]))
        )
        context = context_of(tmp_path / "run", lambda line: None, lambda: order[-1:] == [90])
        run_unit(context, 0, address=str(images))
        assert order[-3:] == ["looked", "reported", 90]

    @pytest.mark.parametrize("scenario", [five_markers, cubes])
    def test_unit_records_robots_instead_of_their_markers(self, tmp_path, monkeypatch, scenario) -> None:
        """The unit's controller sees robots, of which each has five markers."""
        tree = scenario()
        image = next(run_steps(make_mission(tree))).frames[0].sight.image
        images = tmp_path / "images"
        images.mkdir()
        Image.fromarray(image).save(images / "0.png")
        ended = []
        context = context_of(tmp_path / "run", lambda line: None, lambda: bool(ended))
        look = UnitAtWork.look
        monkeypatch.setattr(UnitAtWork, "look", lambda *given: (look(*given), ended.append(1))[0])
        lab = context.lab.model.model_dump(mode="json")
        lab["robots"] = [{"id": robot} for robot in range(6)]
        lab["shape"] = {"points": tree["template"]["points"]}
        lab["markers"] = {"side_m": 0.25, "on_robots": tree["robots"]["markers"]}
        context = replace(context, lab=make_lab(lab))
        run_unit(context, 0, address=str(images))
        records = [
            record
            for topic, record in read_process_log(tmp_path / "run" / "unit_0.mcap")
            if topic == "/detections"
        ]
        assert sorted(records[0]["detections"]["ids"]) == list(range(6))
