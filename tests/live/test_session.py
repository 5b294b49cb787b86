"""Runs of a lab: refused input, the end of a run, keys and the supervisor."""

import http.client
import io
import os
import pty
import subprocess
import sys
import termios
import threading
import time
from contextlib import closing, nullcontext, suppress
from pathlib import Path

import pytest
from command_line import call
from rich.console import Console

from skyherd.errors import InputError
from skyherd.live.cameras import check_camera
from skyherd.live.cockpit import PageAddress
from skyherd.live.lab import load_lab
from skyherd.live.line_writer import NAME
from skyherd.live.mailbox import Air, Mailbox
from skyherd.live.operator import Outcome, watch
from skyherd.live.session import _dashboard, _processes, run_session
from skyherd.live.supervisor import Child, Supervisor
from skyherd.live.wire import Heartbeat
from skyherd.report.access import bind
from skyherd.version import STARTED_S


@pytest.fixture(autouse=True)
def own_locks(monkeypatch, tmp_path) -> None:
    """Use a separate lock folder, since parallel tests run the same built-in lab."""
    monkeypatch.setattr("skyherd.live.name_locks.lock_folder", lambda: tmp_path / "locks")


class TestInput:
    @pytest.mark.parametrize("verb", ["unit", "robot"])
    @pytest.mark.parametrize("offset", ["nan", "inf", "1e300", "-86401"])
    def test_invalid_clock_offset_is_refused(self, capsys, tmp_path, verb, offset) -> None:
        code, out, err = call(capsys, verb, "webcams", 0, "--out", tmp_path / "run", "--clock-offset", offset)
        assert code == 2 and not out and len(err.splitlines()) == 1
        assert f"--clock-offset: {float(offset):g}; a number of seconds, 86400 at most either way" in err
        assert not (tmp_path / "run").exists()

    @pytest.mark.parametrize(
        ("option", "value", "complaint"),
        [
            ("--cameras", ",", "--cameras: address 1 is empty; 2 with commas between"),
            ("--cameras", "", "the argument after --cameras: is empty; "),
            ("--cameras", "a.mp4, ", "--cameras: address 2 is empty; "),
            ("--cameras", "a.mp4", "--cameras: 1 addresses; 2, as in the lab"),
            ("--cameras", "a.mp4,b.mp4,c.mp4", "--cameras: 3 addresses; 2, as in the lab"),
            ("--duration", "nan", "--duration: nan is not a number; a number of seconds from 0, such as 60"),
            ("--duration", "inf", "--duration: inf; a number of seconds above 0"),
            ("--duration", "0", "--duration: 0; a number of seconds above 0"),
            ("--duration", "-5", "--duration: -5 is too small; a number of seconds from 0, such as 60"),
            ("--duration", "-0.5", "--duration: -0.5 is too small; a number of seconds from 0, such as 60"),
        ],
    )
    def test_invalid_options_are_refused_before_start(
        self, capsys, tmp_path, monkeypatch, option, value, complaint
    ) -> None:
        monkeypatch.setattr("skyherd.live.session.ZenohRadio", None)
        code, out, err = call(capsys, "live", "run", "webcams", "--out", tmp_path / "run", option, value)
        assert code == 2 and not out and len(err.splitlines()) == 1 and complaint in err
        assert not (tmp_path / "run").exists()

    def test_empty_camera_address_is_refused(self, capsys, tmp_path, monkeypatch) -> None:
        monkeypatch.setattr("skyherd.live.zenoh_radio.ZenohRadio", None)
        code, out, err = call(capsys, "unit", "webcams", 0, "--out", tmp_path / "run", "--camera", "")
        assert code == 2 and not out and "the argument after --camera: is empty; " in err

    @pytest.mark.parametrize(
        ("options", "complaint"),
        [
            ([], "webcams: cameras.0.address: /dev/video70: no such camera; devices that are there: "),
            (["--cameras", "{0}/a.mp4,{0}/b.mp4"], "--cameras: address 1: {0}/a.mp4: "),
            (["--cameras", "tcp://127.0.0.1:9,{0}/notes.txt"], "--cameras: address 2: {0}/notes.txt: "),
            (["--cameras", "tcp://127.0.0.1:9,notes.txt"], "--cameras: address 2: notes.txt: "),
            (["--cameras", "tcp://127.0.0.1:9,nothing"], "--cameras: address 2: no camera 'nothing'; "),
            (["--set", "robots.3.driver=foo"], "--set robots.3.driver: no driver 'foo'; "),
            (
                ["--set", "robots.3.driver=os:path"],
                "webcams: robots.3.driver: os:path: 'path' is not callable; ",
            ),
        ],
    )
    def test_invalid_cameras_and_drivers_refused_before_start(
        self, capsys, tmp_path, monkeypatch, options, complaint
    ) -> None:
        monkeypatch.setattr("skyherd.live.session.ZenohRadio", None)
        (tmp_path / "notes.txt").write_text("no video")
        monkeypatch.chdir(tmp_path)
        run = ["live", "run", "webcams", "--out", tmp_path / "run", "--set", "cameras.*.address=/dev/video70"]
        code, out, err = call(capsys, *run, *(option.format(tmp_path) for option in options))
        assert code == 2 and not out and len(err.splitlines()) == 1 and complaint.format(tmp_path) in err
        assert not (tmp_path / "run").exists()

    def test_check_camera_opens_no_streams_or_folders(self, tmp_path) -> None:
        check_camera("rtsp://user:secret@no-such-host.invalid/1")
        check_camera(str(tmp_path))
        with pytest.raises(InputError, match="no address"):
            check_camera("ftp://host/1")


class Silence:
    """Radio without other processes."""

    def __init__(self, *places, **options) -> None:
        pass

    def publish(self, topic, data) -> None:
        pass

    def subscribe(self, pattern, take) -> None:
        pass

    def close(self) -> None:
        pass


STAYS, FAILS, ENDS = "import sys; sys.stdin.read()", "raise SystemExit(2)", "pass"
ENDS_AFTER_A_FAILURE = """
import pathlib, sys, time
while "ended with code 2" not in pathlib.Path(sys.argv[1], "live.log").read_text():
    time.sleep(0.05)
"""


@pytest.mark.parametrize(
    ("programs", "code", "lines"),
    [
        ({"unit/": FAILS}, 2, ["no unit is left", "ended with code 2: unit/0, unit/1; see live.log"]),
        (
            {"robot/": FAILS},
            2,
            ["no robot is left", "ended with code 2: robot/0, robot/1, robot/2, robot/3;"],
        ),
        ({"unit/": ENDS}, 0, ["no unit is left"]),
        (
            {"unit/": ENDS_AFTER_A_FAILURE, "robot/2": FAILS},
            2,
            ["no unit is left", "ended with code 2: robot/2; see live.log"],
        ),
    ],
)
def test_run_without_units_or_robots_ends_with_exit_code(
    capsys, tmp_path, monkeypatch, programs, code, lines
) -> None:
    folder = tmp_path / "run"

    def add(supervisor, name, arguments) -> None:
        program = next((text for begin, text in programs.items() if name.startswith(begin)), STAYS)
        supervisor.take(Child(name, [sys.executable, "-c", program, str(folder)]))

    left: list[int] = []
    monkeypatch.setattr(Supervisor, "add", add)
    monkeypatch.setattr("skyherd.live.session.ZenohRadio", Silence)
    monkeypatch.setattr("skyherd.live.line_writer.leave_if_held", left.append)
    streams = "tcp://127.0.0.1:9,tcp://127.0.0.1:9"
    found, out, _ = call(capsys, "live", "run", "webcams", "--out", folder, "--cameras", streams)
    assert found == code and left == [code]
    for text in (out, (folder / "live.log").read_text()):
        printed = [line.partition(" live ")[2].strip() for line in text.splitlines()]
        printed = [line for line in printed if "left" in line or "code" in line]
        assert len(printed) == len(lines) and all(map(str.startswith, printed, lines)), printed


HELD_TO_THE_END = """
import os, pty, sys, termios
from skyherd.live import line_writer
from skyherd.live.screen import Screen
master, slave = pty.openpty()
termios.tcflow(slave, termios.TCOOFF)
file = os.fdopen(slave, "w")
line_writer.CLOSE_S = 0.2
shown = Screen(None, lambda line: (file.write(line), file.flush()))
shown.tell("a line")
assert not shown.close()
line_writer.leave_if_held(7)
sys.exit("the process went on")
"""


def test_process_leaves_a_terminal_that_is_held_to_the_end() -> None:
    ended = subprocess.run([sys.executable, "-c", HELD_TO_THE_END], timeout=60, check=False)
    assert ended.returncode == 7


def test_arm_is_given_when_its_process_starts(capsys, monkeypatch) -> None:
    given: list[float] = []

    def arm(lab, watched, *, given_s, robots):
        given.append(given_s)
        return Outcome(lab.ids, {})

    team = nullcontext((load_lab("triangle"), Silence()))
    monkeypatch.setattr("skyherd.cli.live.joined_team", lambda *options: team)
    monkeypatch.setattr("skyherd.live.operator.arm", arm)
    assert call(capsys, "live", "arm", "triangle")[0] == 0
    assert given == [STARTED_S]


def post_stop(url: str) -> int:
    """Ask the page to stop, as its button does; return the status."""
    origin, _, token = url.partition("/?token=")
    host = origin.removeprefix("http://")
    with closing(http.client.HTTPConnection(host, timeout=10)) as connection:
        cookie = f"skyherd_{host.partition(':')[2]}={token}"
        connection.request("POST", "/stop", headers={"Origin": origin, "Cookie": cookie})
        return connection.getresponse().status


STREAMS = ["tcp://127.0.0.1:9", "tcp://127.0.0.1:9"]
"""Addresses of cameras that are not opened before the processes of a run start."""


class ScriptedRun:
    """A run of the lab `webcams` with real child processes of other programs, and without other machines.

    Attributes:
        programs: command line of each process by its name; `cat`, which waits for the end, for all others.
        survivors: names of processes that no signal reaches.
        arguments: arguments of each process that was started, by name.
        stops_s: times at which a stop was sent.
        closed: how often the radio was closed.
        said: lines for people.
    """

    def __init__(self, monkeypatch, folder) -> None:
        self.folder, self.programs, self.survivors = folder, {}, ()
        self.arguments, self.stops_s, self.closed, self.said = {}, [], 0, []
        self.children = []
        monkeypatch.setattr("skyherd.live.session.ZenohRadio", lambda *places, **options: self)
        monkeypatch.setattr("skyherd.live.session.REFRESH_S", 0.02)

    def publish(self, topic, data) -> None:
        if "/stop/" in topic:
            self.stops_s.append(time.monotonic())

    def subscribe(self, pattern, take) -> None:
        pass

    def close(self) -> None:
        self.closed += 1

    def run(self, *, ended=None, folder=..., **options) -> int:
        limit_s = time.monotonic() + 8
        given = {"cameras": STREAMS, "dry_run": False, "armed": False, "duration_s": None, "settings": []}
        return run_session(
            load_lab("webcams"),
            "webcams",
            self.folder if folder is ... else folder,
            insecure=False,
            ended=ended or (lambda: time.monotonic() > limit_s),
            **given | {"say": self.said.append} | options,
        )

    @property
    def log(self) -> str:
        return (self.folder / "live.log").read_text()


@pytest.fixture
def scripted_run(monkeypatch, tmp_path):
    run = ScriptedRun(monkeypatch, tmp_path / "run")

    def add(supervisor, name, arguments) -> None:
        run.arguments[name] = arguments
        child = Child(name, run.programs.get(name, ["cat"]))
        supervisor.take(child)
        run.children.append(child)
        if name in run.survivors:
            child.process.terminate = child.process.kill = lambda: None

    monkeypatch.setattr(Supervisor, "add", add)
    yield run
    for child in run.children:
        if child.process is not None:
            child.process.wait(10)


@pytest.fixture
def held_terminal():
    """Yield the console of a terminal that takes no output, as after Ctrl-S."""
    master, slave = pty.openpty()
    termios.tcflow(slave, termios.TCOOFF)
    file = os.fdopen(slave, "w")
    yield Console(file=file, force_terminal=True, width=100, height=40)
    termios.tcflow(slave, termios.TCOON)
    os.close(master)  # A writer gets an error from now on.
    for thread in threading.enumerate():
        if thread.name.startswith(NAME):
            thread.join(5.0)
    with suppress(OSError):
        file.close()


@pytest.fixture
def screen(monkeypatch):
    """Return the text written to a terminal that replaces the standard output."""
    monkeypatch.setenv("TERM", "xterm")
    text = io.StringIO()
    console = Console(file=text, force_terminal=True, width=100, height=40)
    monkeypatch.setattr("skyherd.live.session.Console", lambda: console)
    return text


class TestRun:
    def test_ends_when_its_duration_is_over(self, scripted_run) -> None:
        began_s = time.monotonic()
        assert scripted_run.run(duration_s=0.6) == 0
        assert scripted_run.stops_s[0] - began_s >= 0.6
        assert "interrupted" not in scripted_run.log

    def test_interruption_stops_robots_and_ends_processes(self, scripted_run) -> None:
        """The stop is sent at once, and repeated while the run waits for its confirmation."""
        calls = iter([False, False])
        assert scripted_run.run(ended=lambda: next(calls, True)) == 0
        assert "interrupted; ending all processes" in scripted_run.log
        assert len(scripted_run.stops_s) == 2
        assert scripted_run.closed == 1
        assert all(child.process is None and child.code is not None for child in scripted_run.children)
        assert scripted_run.said[-1].startswith(f"recorded in {scripted_run.folder}; ")

    def test_page_stops_the_team_and_ends_with_the_run(self, scripted_run) -> None:
        asked = []

        def ended() -> bool:
            if not asked:
                asked.append(post_stop(scripted_run.said[0].removeprefix("open ")))
            return len(scripted_run.stops_s) > 0

        assert scripted_run.run(ended=ended, page=PageAddress("127.0.0.1", 0)) == 0
        assert asked == [202] and len(scripted_run.stops_s) > 1
        for name, arguments in scripted_run.arguments.items():
            assert ("--preview" in arguments) == name.startswith("unit/")
        assert not (scripted_run.folder / "preview").exists()
        with pytest.raises(OSError, match="refused"):
            post_stop(scripted_run.said[0].removeprefix("open "))

    @pytest.mark.parametrize("shows_dashboard", [False, True])
    def test_held_terminal_delays_no_stop(
        self, scripted_run, held_terminal, monkeypatch, shows_dashboard
    ) -> None:
        """The page asks for a stop after the terminal was held, as by Ctrl-S; then the run is ended."""
        monkeypatch.setattr("skyherd.live.line_writer.CLOSE_S", 0.2)
        if shows_dashboard:
            monkeypatch.setattr("skyherd.live.session.Console", lambda: held_terminal)
        urls, asked_s, polls = [], [], iter(range(1000))

        def say(line: str) -> None:
            if line.startswith("open "):
                urls.append(line.removeprefix("open "))
            else:
                held_terminal.file.write(line + "\n")
                held_terminal.file.flush()

        def ended() -> bool:
            if next(polls) == 4:
                asked_s.append(time.monotonic())
                assert post_stop(urls[0]) == 202
            return len(scripted_run.stops_s) > 2

        assert scripted_run.run(ended=ended, page=PageAddress("127.0.0.1", 0), say=say) == 0
        assert scripted_run.stops_s[0] - asked_s[0] < 1.0
        assert any(thread.name.startswith(NAME) for thread in threading.enumerate()), "the terminal is held"
        assert all(child.code is not None for child in scripted_run.children)

    def test_page_whose_port_is_taken_leaves_no_folder(self, scripted_run) -> None:
        with bind("127.0.0.1", 0) as listener, pytest.raises(InputError, match=r"^port: "):
            scripted_run.run(page=PageAddress("127.0.0.1", listener.getsockname()[1]))
        assert not scripted_run.folder.exists() and scripted_run.closed == 1

    def test_crashed_process_is_restarted(self, scripted_run, tmp_path, monkeypatch) -> None:
        monkeypatch.setattr("skyherd.live.supervisor.MAX_WAIT_S", 0.01)
        mark = tmp_path / "started"
        scripted_run.programs["robot/1"] = ["sh", "-c", f"test -e {mark} && exec cat; touch {mark}; exit 7"]
        restarted = lambda: any(child.restarts for child in scripted_run.children)  # noqa: E731
        assert scripted_run.run(ended=restarted) == 0
        assert "robot/1   ended with code 7; restarts in" in scripted_run.log

    @pytest.mark.parametrize("terminal", [False, True])
    def test_surviving_process_is_named(self, scripted_run, request, monkeypatch, terminal) -> None:
        if terminal:
            request.getfixturevalue("screen")
        monkeypatch.setattr("skyherd.live.supervisor.END_S", 0.1)
        monkeypatch.setattr("skyherd.live.supervisor.KILL_S", 0.1)
        scripted_run.survivors = ("robot/1", "unit/0")
        assert scripted_run.run(ended=lambda: True) == 1
        assert "still running: unit/0, robot/1" in scripted_run.said

    def test_end_is_explained_once_on_a_terminal(self, scripted_run, screen) -> None:
        scripted_run.programs = {"unit/0": ["sh", "-c", "exit 2"], "unit/1": ["true"]}
        assert scripted_run.run() == 2
        *lines, last = scripted_run.said
        assert lines == ["no unit is left", "ended with code 2: unit/0; see live.log for the errors"]
        assert last.startswith("recorded in ")

    def test_dashboard_fills_a_terminal(self, scripted_run, screen) -> None:
        limit_s, head = time.monotonic() + 8, "team table: 0 of 4 robots armed"
        scripted_run.run(ended=lambda: head in screen.getvalue() or time.monotonic() > limit_s)
        assert head in screen.getvalue() and "\x1b[?1049h" in screen.getvalue()

    def test_end_is_explained_once_without_a_terminal(self, scripted_run) -> None:
        scripted_run.programs = {"unit/0": ["true"], "unit/1": ["true"]}
        assert scripted_run.run() == 0
        assert sum("no unit is left" in line for line in scripted_run.said) == 1
        assert not any("still running" in line for line in scripted_run.said)

    def test_processes_receive_the_options(self, scripted_run) -> None:
        scripted_run.run(cameras=["tcp://h:1", "tcp://h:2"], settings=["a=1"], ended=lambda: True)
        common = ["--out", str(scripted_run.folder), "--supervised", "--set", "a=1"]
        robots = {f"robot/{robot}": ["robot", "webcams", str(robot), *common] for robot in range(4)}
        units = {
            f"unit/{unit}": ["unit", "webcams", str(unit), "--camera", f"tcp://h:{unit + 1}", *common]
            for unit in range(2)
        }
        assert scripted_run.arguments == units | robots

    def test_default_folder_is_named_after_team(self, scripted_run, tmp_path, monkeypatch) -> None:
        monkeypatch.chdir(tmp_path)
        scripted_run.run(folder=None, ended=lambda: True)
        (made,) = (tmp_path / "runs").iterdir()
        assert made.name.startswith("table-2") and (made / "live.log").exists()

    def test_existing_folder_is_refused(self, scripted_run) -> None:
        scripted_run.folder.mkdir()
        with pytest.raises(InputError, match=r"run: File exists; a folder that does not exist"):
            scripted_run.run(ended=lambda: True)
        assert scripted_run.closed == 1 and not scripted_run.arguments


def test_dashboard_shows_state_of_each_process(tmp_path) -> None:
    lab, air = load_lab("triangle"), Air()
    watched = watch(lab, air.radio("operator"), lambda: 0.0)
    beats = [
        ("unit/0", Heartbeat({}, "5 images/s")),
        ("robot/0", Heartbeat({}, "driving", "session", armed=True)),
        ("robot/1", Heartbeat({}, "waiting", "session", armed=False)),
        ("robot/3", Heartbeat({}, "first", "session", armed=False)),
        ("robot/3", Heartbeat({}, "second", "session", armed=False)),
    ]
    senders = [
        (Mailbox(air.radio(name), lab.model.team, name, lambda: 0.0, ()), beat) for name, beat in beats
    ]
    for _ in range(3):
        for mailbox, beat in senders:
            mailbox.send(beat)
    air.advance(0.0)
    watched.listen(0.0)
    supervisor = Supervisor(tmp_path / "live.log")
    restarts = {"unit/0": 0, "robot/0": 1, "robot/1": 3, "robot/2": 0, "robot/3": 0}
    supervisor.children = [Child(name, [], count) for name, count in restarts.items()]
    console = Console(file=io.StringIO(), width=100)
    console.print(
        _dashboard(
            lab, watched, _processes(watched, supervisor), ["a line", "another"], "http://127.0.0.1:1/"
        )
    )
    supervisor.end()
    head, *rows = [line.split() for line in console.file.getvalue().splitlines()]
    assert " ".join(head) == "team triangle: 1 of 6 robots armed. a: arm space: STOP Ctrl-C: end"
    assert rows == [
        ["process", "starts", "armed", "state"],
        ["unit/0", "1", "5", "images/s"],
        ["robot/0", "2", "ARMED", "driving"],
        ["robot/1", "4", "no", "waiting"],
        ["robot/2", "1", "no", "heartbeat"],
        ["robot/3", "1", "no", "two", "processes", "are", "named", "robot/3"],
        ["page:", "http://127.0.0.1:1/"],
        ["a", "line"],
        ["another"],
    ]


class TestSupervisor:
    def test_lines_of_several_threads_stay_separate(self, tmp_path) -> None:
        """Each process has a thread, and each line takes two writes, as on a terminal."""
        written = []

        def tell(line: str) -> None:
            written.append(line)
            time.sleep(0.001)
            written.append("\n")

        supervisor = Supervisor(tmp_path / "live.log", tell)
        threads = [
            threading.Thread(target=lambda name=name: [supervisor.say(name, str(n)) for n in range(20)])
            for name in ("robot/1", "robot/2", "unit/0")
        ]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        supervisor.end()
        assert written[1::2] == ["\n"] * 60 and "\n" not in written[::2]

    @pytest.mark.skipif(not Path("/dev/full").exists(), reason="no device that is always full")
    def test_full_disk_loses_lines_of_the_log_and_nothing_else(self) -> None:
        told = []
        supervisor = Supervisor(Path("/dev/full"), told.append)
        lines = "for number in range(2000): print('a line of some length', number)"
        supervisor.take(Child("robot/1", [sys.executable, "-c", lines]))
        limit_s = time.monotonic() + 10
        while len(told) < 2000 and time.monotonic() < limit_s:
            time.sleep(0.01)
        supervisor.say("live", "the end")
        assert len(told) == 2001 and supervisor.end() == []

    def test_disk_that_hangs_holds_neither_caller_nor_processes(self, tmp_path, monkeypatch) -> None:
        """The log is a pipe without a reader at work, which is full after a few hundred lines."""
        monkeypatch.setattr("skyherd.live.line_writer.CLOSE_S", 0.2)
        log, told = tmp_path / "live.log", []
        os.mkfifo(log)
        reader = os.open(log, os.O_RDONLY | os.O_NONBLOCK)
        supervisor = Supervisor(log, told.append)
        lines = "for number in range(2000): print('a line of some length' * 10, number)"
        supervisor.take(Child("robot/1", [sys.executable, "-c", lines]))
        began_s = time.monotonic()
        while len(told) < 2000 and time.monotonic() < began_s + 10:
            supervisor.say("live", "something else") if not len(told) % 100 else time.sleep(0.001)
        assert sum("robot/1" in line for line in told) == 2000
        assert supervisor.end() == [] and time.monotonic() < began_s + 5
        writers = [thread for thread in threading.enumerate() if thread.name.startswith(NAME)]
        assert writers, "the log is held to the end"
        while any(thread.is_alive() for thread in writers):
            with suppress(BlockingIOError):
                os.read(reader, 2**16)
        supervisor._file.close()
        os.close(reader)

    def test_end_returns_surviving_processes(self, tmp_path, monkeypatch) -> None:
        """A process that waits for a device cannot be killed. Here, `kill` has no effect."""
        supervisor = Supervisor(tmp_path / "live.log")
        monkeypatch.setattr("skyherd.live.supervisor.END_S", 0.1)
        monkeypatch.setattr("skyherd.live.supervisor.KILL_S", 0.1)
        child = Child("robot/1", [sys.executable, "-c", "import sys; sys.stdin.read()"])
        supervisor.take(child)
        process = child.process
        monkeypatch.setattr(process, "terminate", lambda: None)
        kill = process.kill
        monkeypatch.setattr(process, "kill", lambda: None)
        assert supervisor.end() == ["robot/1"]
        kill()
        process.wait()
