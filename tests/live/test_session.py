"""Runs of a lab: refused input, the end of a run, keys and the supervisor."""

import os
import pty
import sys
import threading
import time
import tty

import pytest
from command_line import call

from skyherd.errors import InputError
from skyherd.live.cameras import check_camera
from skyherd.live.session import _keys
from skyherd.live.supervisor import Child, Supervisor


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
            ("--duration", "nan", "--duration: nan; a number of seconds above 0"),
            ("--duration", "inf", "--duration: inf; a number of seconds above 0"),
            ("--duration", "0", "--duration: 0; a number of seconds above 0"),
            ("--duration", "-5", "--duration: -5; a number of seconds above 0"),
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

    monkeypatch.setattr(Supervisor, "add", add)
    monkeypatch.setattr("skyherd.live.session.ZenohRadio", Silence)
    streams = "tcp://127.0.0.1:9,tcp://127.0.0.1:9"
    found, out, _ = call(capsys, "live", "run", "webcams", "--out", folder, "--cameras", streams)
    assert found == code
    for text in (out, (folder / "live.log").read_text()):
        printed = [line.partition(" live ")[2].strip() for line in text.splitlines()]
        printed = [line for line in printed if "left" in line or "code" in line]
        assert len(printed) == len(lines) and all(map(str.startswith, printed, lines)), printed


@pytest.fixture
def keyboard(monkeypatch):
    """Yield the typing end of a pseudo terminal that replaces the standard input."""
    person, terminal = pty.openpty()
    tty.setcbreak(terminal)
    with os.fdopen(terminal) as stream:
        monkeypatch.setattr(sys, "stdin", stream)
        yield person
    os.close(person)


def test_space_bar_has_priority_among_keys(keyboard):
    with _keys() as key:
        assert key() == ""
        for typed, meant in (
            (b" ", " "),
            (b"xx a", " "),
            (b"qqqq ", " "),
            (b" aa", " "),
            (b"qa", "a"),
            (b"aq", "q"),
        ):
            os.write(keyboard, typed)
            assert key() == meant, typed
            assert key() == "", "all that was typed was read"


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
