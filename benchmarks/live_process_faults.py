"""Measure the behaviour of a live team of real processes under faults, judged at the wheels of its world.

    python benchmarks/live_process_faults.py --times 10 --json faults.json --table faults.md

`skyherd world triangle` and `skyherd live run --arm` run as they do for users: processes, Zenoh on loopback,
and an H.264 stream over TCP. A relay in this process can cut the stream or hold it back. Each run lasts 30 to
60 s of real time, and the fault occurs a few seconds after the robots began to drive. Faults of the radio and
of clocks run in memory (`benchmarks/live_faults.py`).

Columns:

- `longest blind s`: longest time that a wheel turned after the newest image that its robot had a goal from,
  by the world's record of the wheels and the robots' logs. The limit is `goal_timeout_s`, a period, and half
  a second of the wheels' keep-alive where a process was killed.
- `after a stop s`: longest time that a wheel turned after `skyherd live stop` had begun to send its stop, or
  after the signal that ends the run. The same limit.
- `after waking`: runs in which a wheel of a robot that was suspended during the stop turned after it woke up.
- `formed`: runs whose shape error was below 2 % at the end.
- `lost s`: the longest stretch at the end of a killed process's log that is missing.
- `left`: processes that were still there after the end.
- `code`: exit codes of `skyherd live run` that differ from the documented one.
"""

import os
import resource
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import orjson
from live_faults import STOP_COLUMNS, fault_table, measure
from mcap.reader import make_reader

from skyherd.errors import InputError
from skyherd.files.atomic import write_text
from skyherd.live.lab import LabRadio, lab_text, load_lab
from skyherd.live.logs.process_log_file import read_process_log
from skyherd.live.logs.replay import replay
from skyherd.live.wire import MAX_BYTES

SKYHERD = [sys.executable, "-m", "skyherd"]
DRIVE_S, FAULT_S, AFTER_S = 60.0, 3.0, 20.0
"""Longest wait until all robots drive; from then on to the fault, and from the fault to the end, s."""

GAINS = ["--set", "control.k=0.3", "--set", "control.k_omega=1.2"]
"""Gains: three times those of the example, so that a run takes half a minute. Chosen."""

KEEP_ALIVE_S = 0.5
"""Keep-alive of the world's wheels, s (`skyherd.live.world.process.HOLD_S`)."""

FORMED = 0.02
STALL_S = 3.0
DISK_BYTES = 600_000
"""Size that no file may exceed in the fault of the full disk: a few seconds of a recording."""


class Relay:
    """Passes a camera's stream on, from one port to another, and can cut it or hold it back."""

    def __init__(self, port: int) -> None:
        self._port, self._held, self._links = port, threading.Event(), []
        self._held.set()
        self._socket = socket.create_server(("127.0.0.1", 0))
        self.port = int(self._socket.getsockname()[1])
        threading.Thread(target=self._accept, daemon=True).start()

    def cut(self) -> None:
        """End all connections, as a camera that is switched off does."""
        for link in self._links:
            with suppress(OSError):
                link.shutdown(socket.SHUT_RDWR)

    def hold(self) -> None:
        """Hold all data back until `release`, which then sends the old data."""
        self._held.clear()

    def release(self) -> None:
        """Send all data that was held back, and resume."""
        self._held.set()

    def close(self) -> None:
        """Close all sockets."""
        self.release()
        self.cut()
        self._socket.close()

    def _accept(self) -> None:
        with suppress(OSError):
            while True:
                viewer, _ = self._socket.accept()
                threading.Thread(target=self._pass, args=[viewer], daemon=True).start()

    def _pass(self, viewer: socket.socket) -> None:
        with viewer, suppress(OSError), socket.create_connection(("127.0.0.1", self._port)) as camera:
            self._links = [viewer, camera]
            while data := camera.recv(1 << 16):
                self._held.wait()
                viewer.sendall(data)


@dataclass
class Team:
    """A world and a live team that run.

    Attributes:
        folder: of all that is recorded.
        lab_file: the set-up.
        world: the world's process.
        session: `skyherd live run`.
        relay: of the camera's stream.
        radio: where the team's radio listens.
        killed: by name of a process's recording, when it was killed, s since 1970.
        stopped_s: when the team was stopped, s since 1970; None if it was not.
        woke: by robot, when it woke up, s since 1970, if it was suspended during the stop.
        facts: what else a fault found, as entries of its row.
    """

    folder: Path
    lab_file: Path
    world: "subprocess.Popen[bytes]"
    session: "subprocess.Popen[bytes]"
    relay: Relay
    radio: str
    killed: dict[str, float] = field(default_factory=dict)
    stopped_s: float | None = None
    woke: dict[int, float] = field(default_factory=dict)
    facts: dict[str, Any] = field(default_factory=dict)

    def stop(self) -> str:
        """Run `skyherd live stop`, and return what it prints."""
        command = [*SKYHERD, "live", "stop", str(self.lab_file)]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        # It sends its stop before it waits for answers: at the first robot that says so, or earlier.
        self.stopped_s = _first_stop_s(self.folder / "run") or time.time()
        return done.stdout

    @property
    def log(self) -> str:
        """Return the output of all processes."""
        path = self.folder / "run" / "live.log"
        return path.read_text(encoding="utf-8") if path.exists() else ""

    def processes(self) -> dict[str, int]:
        """Return process ids by name, such as `robot/3`, of all running units and robots."""
        found = {}
        for path in Path("/proc").glob("[0-9]*/cmdline"):
            with suppress(OSError):
                parts = path.read_bytes().decode(errors="replace").split("\0")
                if str(self.lab_file) in parts and parts[3] in ("unit", "robot"):
                    found[f"{parts[3]}/{parts[5]}"] = int(path.parent.name)
        return found

    def kill(self, name: str) -> None:
        """Kill a process."""
        os.kill(self.processes()[name], signal.SIGKILL)
        self.killed[name.replace("/", "_")] = time.time()


Fault = Callable[[Team, np.random.Generator], None]


def nothing(team: Team, rng: np.random.Generator) -> None:
    """Run without a fault."""


def unit_killed(team: Team, rng: np.random.Generator) -> None:
    """Kill the unit by SIGKILL; the supervisor restarts it."""
    team.kill("unit/0")


def robot_killed(team: Team, rng: np.random.Generator) -> None:
    """Kill a robot by SIGKILL; it restarts and stays disarmed."""
    team.kill(f"robot/{rng.integers(6)}")


def stream_cut(team: Team, rng: np.random.Generator) -> None:
    """Close the camera's connection; the unit connects again."""
    team.relay.cut()


def stream_stalls(team: Team, rng: np.random.Generator) -> None:
    """Hold the stream back for a while, and then send all old pictures at once."""
    team.relay.hold()
    time.sleep(STALL_S)
    team.relay.release()


def unit_sleeps(team: Team, rng: np.random.Generator) -> None:
    """Send SIGSTOP and SIGCONT to the unit."""
    _sleep(team.processes()["unit/0"])


def robot_sleeps(team: Team, rng: np.random.Generator) -> None:
    """Send SIGSTOP and SIGCONT to a robot."""
    _sleep(team.processes()[f"robot/{rng.integers(6)}"])


def _sleep(process: int) -> None:
    os.kill(process, signal.SIGSTOP)
    time.sleep(STALL_S)
    os.kill(process, signal.SIGCONT)


def supervisor_killed(team: Team, rng: np.random.Generator) -> None:
    """Kill `skyherd live run` by SIGKILL; its child processes end by themselves."""
    team.session.kill()


def garbage(team: Team, rng: np.random.Generator) -> None:
    """Send ten seconds of invalid messages, some of them too large, to every topic."""
    from skyherd.live.zenoh_radio import ZenohRadio

    radio = ZenohRadio(LabRadio(listen=[team.radio], connect=[team.radio]), team.folder)
    end_s = time.monotonic() + 10.0
    while time.monotonic() < end_s:
        size = 2 * MAX_BYTES if rng.random() < 0.01 else int(rng.integers(200))
        for topic in (
            "goals/unit/0",
            "sighting/unit/0",
            "heartbeat/unit/0",
            "report/unit/1",
            "arm/x",
            "stop/x",
        ):
            radio.publish(f"skyherd/triangle/{topic}", rng.bytes(size))
        time.sleep(0.02)
    radio.close()


def missed_stop(team: Team, rng: np.random.Generator) -> None:
    """Suspend a robot, stop the team, and wake the robot up."""
    robot = int(rng.integers(6))
    process = team.processes()[f"robot/{robot}"]
    os.kill(process, signal.SIGSTOP)
    time.sleep(rng.uniform(0.5, 2.0))
    team.facts["said"] = team.stop()
    team.woke[robot] = time.time()
    os.kill(process, signal.SIGCONT)


def pending_arm(team: Team, rng: np.random.Generator) -> None:
    """Stop a team that was started with `--arm` and a suspended robot, and wake the robot up."""
    robot = team.facts["suspended"]
    team.facts["said"] = team.stop()
    team.woke[robot] = time.time()
    os.kill(team.processes()[f"robot/{robot}"], signal.SIGCONT)


def second_team(team: Team, rng: np.random.Generator) -> None:
    """Start a second world and a second `live run` of the lab: both are refused."""
    port = str(_free_port())
    lab = str(team.lab_file)
    commands = {
        "world": ["world", "triangle", "--lab", lab, "--port", port],
        "live run": ["live", "run", lab, "--out", str(team.folder / "second")],
        "robot": ["robot", lab, "3", "--out", str(team.folder / "second")],
    }
    for name, command in commands.items():
        done = subprocess.run([*SKYHERD, *command], capture_output=True, text=True, check=False)
        refused = done.returncode == 2 and "already runs on this machine" in done.stderr
        team.facts[f"second {name} refused"] = refused
    team.facts["others"] = sum(not refused for refused in list(team.facts.values()))


def second_interrupt(pause_s: float) -> Fault:
    """Return a fault of two Ctrl-C."""

    def fault(team: Team, rng: np.random.Generator) -> None:
        team.stopped_s = time.time()
        team.session.send_signal(signal.SIGINT)
        time.sleep(pause_s)
        team.session.send_signal(signal.SIGINT)
        with suppress(subprocess.TimeoutExpired):
            team.session.wait(30)
        team.facts["ended_s"] = time.time() - team.stopped_s
        team.facts["left"] = sorted(team.processes())
        team.facts["wrong_code"] = team.session.poll() != 130

    fault.__doc__ = f"Interrupt by Ctrl-C, and again after {pause_s:g} s."
    return fault


FAULTS: dict[str, Fault] = {
    "none": nothing,
    "unit killed": unit_killed,
    "robot killed": robot_killed,
    "stream cut": stream_cut,
    "stream stalls 3 s, then old pictures": stream_stalls,
    "unit sleeps 3 s": unit_sleeps,
    "robot sleeps 3 s": robot_sleeps,
    "supervisor killed": supervisor_killed,
    "garbage": garbage,
    "disk full": nothing,
    "missed stop": missed_stop,
    "pending arm": pending_arm,
    "second team": second_team,
    **{f"second Ctrl-C after {pause_s:g} s": second_interrupt(pause_s) for pause_s in (0.05, 0.2, 0.6, 1.5)},
}


def run(fault: str, seed: int, folder: Path) -> dict[str, Any]:
    """Run once with one fault and return the row."""
    rng = np.random.default_rng([seed, 21])
    team = _start(folder, seed, full=fault == "disk full")
    try:
        if fault == "pending arm":
            drives = _suspend_one(team, int(rng.integers(6)))
        else:
            drives = _wait_until(lambda: team.log.count("driving") >= 6)
        time.sleep(FAULT_S + rng.uniform(0, 1))
        FAULTS[fault](team, rng)
        if team.session.poll() is None:
            time.sleep(AFTER_S)
        if fault == "robot killed":
            subprocess.run([*SKYHERD, "live", "arm", str(team.lab_file)], capture_output=True, check=False)
            time.sleep(AFTER_S / 2)
        team.session.terminate()
        with suppress(subprocess.TimeoutExpired):
            team.session.wait(30)
        left = sorted({*team.processes(), *team.facts.pop("left", [])})
    finally:
        for process in (team.session, team.world):
            process.terminate()
            with suppress(subprocess.TimeoutExpired):
                process.wait(15)
            process.kill()
        for process_id in team.processes().values():
            os.kill(process_id, signal.SIGKILL)
        team.relay.close()
    facts = {"wrong_code": False, "others": 0, **team.facts}
    return {"fault": fault, "seed": seed, "drives": drives, "left": left, **facts, **_judge(team)}


def _wait_until(holds: Callable[[], bool]) -> bool:
    """Wait until a condition holds, for `DRIVE_S` at most; return whether it does."""
    end_s = time.monotonic() + DRIVE_S
    while not holds() and time.monotonic() < end_s:
        time.sleep(0.1)
    return holds()


def _suspend_one(team: Team, robot: int) -> bool:
    """Suspend a robot at its start, wait for all others, and return whether they are there."""
    name = f"robot/{robot}"
    _wait_until(lambda: name in team.processes())
    os.kill(team.processes()[name], signal.SIGSTOP)
    team.facts["suspended"] = robot
    others = [f"robot/{other}" for other in range(6) if other != robot]
    return _wait_until(lambda: all(other in team.log for other in others))


def _first_stop_s(folder: Path) -> float | None:
    """Return when the first robot heard a stop, by the robots' logs, s since 1970, or None."""
    heard_s = []
    for path in folder.glob("robot_*.mcap"):
        with suppress(InputError):
            heard_s += [
                record["received_s"]
                for topic, record in read_process_log(path)
                if topic == "/heard" and record["stop"] > 0
            ]
    return min(heard_s, default=None)


def _start(folder: Path, seed: int, *, full: bool) -> Team:
    """Start a world and its team, armed."""
    radio, camera = f"tcp/127.0.0.1:{_free_port()}", _free_port()
    relay = Relay(camera)
    lab_file = folder / "lab.toml"
    text = lab_text("triangle").replace("tcp://127.0.0.1:7461", f"tcp://127.0.0.1:{relay.port}")
    write_text(lab_file, f'{text}\n[radio]\nlisten = ["{radio}"]\nconnect = ["{radio}"]\n')
    world = [
        *(*SKYHERD, "world", "triangle", "--lab", str(lab_file), "--port", str(camera)),
        *("--record", str(folder / "world.mcap"), "--set", f"seed={seed}", "--set", "duration_s=200"),
        *("--set", "units.0.frame_rate_hz=5"),
    ]
    session = [*SKYHERD, "live", "run", str(lab_file), "--arm", "--out", str(folder / "run"), *GAINS]
    return Team(
        folder,
        lab_file,
        subprocess.Popen(world, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL),
        subprocess.Popen(
            session,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            preexec_fn=lambda: _prepare(full=full),
        ),
        relay,
        radio,
    )


def _prepare(*, full: bool) -> None:
    """Let Ctrl-C reach the process also if this script runs in the background, where shells ignore it.

    Args:
        full: let writing fail beyond a size, as on a disk that is full.
    """
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    if full:
        resource.setrlimit(resource.RLIMIT_FSIZE, (DISK_BYTES, DISK_BYTES))


def _free_port() -> int:
    with socket.socket() as there:
        there.bind(("127.0.0.1", 0))
        return int(there.getsockname()[1])


def _judge(team: Team) -> dict[str, Any]:
    """Return the row that follows from the recordings of the world and the processes."""
    limits = load_lab(str(team.lab_file), []).model.limits
    with (team.folder / "world.mcap").open("rb") as stream:
        messages = make_reader(stream).iter_messages(topics=["/truth"])
        truth = [orjson.loads(message.data) for _, _, message in messages]
    blind_s, lost_s, turned_s, after_waking = 0.0, 0.0, None if team.stopped_s is None else 0.0, False
    for step in truth if team.stopped_s is not None else []:
        for robot, (v_mps, omega_radps) in enumerate(zip(step["v_mps"], step["omega_radps"], strict=True)):
            if (v_mps or omega_radps) and step["now_s"] > team.stopped_s:
                turned_s = max(turned_s, step["now_s"] - team.stopped_s)
                after_waking |= step["now_s"] >= team.woke.get(robot, np.inf)
    robots = range(len(truth[0]["v_mps"]))
    for robot in robots:
        imaged = []
        for path in sorted((team.folder / "run").glob(f"robot_{robot}*.mcap")):
            for topic, record in read_process_log(path):
                if topic == "/decide" and record["image_age_s"] is not None:
                    imaged.append((record["now_s"], record["now_s"] - record["image_age_s"]))
        if not imaged:
            continue
        decided_s, image_s = np.array(sorted(imaged)).T
        for step in truth:
            if step["v_mps"][robot] or step["omega_radps"][robot]:
                known = np.searchsorted(decided_s, step["now_s"], side="right")
                if known:
                    blind_s = max(blind_s, step["now_s"] - image_s[:known].max())
    different, unread = 0, []
    for path in sorted((team.folder / "run").glob("*.mcap")):
        replayed = replay(path)
        different += replayed.different
        if path.stem in team.killed:
            last_s = max(record["now_s"] for _, record in read_process_log(path) if "now_s" in record)
            lost_s = max(lost_s, team.killed[path.stem] - last_s)
        elif not replayed.ended:
            unread.append(path.stem)
    limit_s = limits.goal_timeout_s + limits.period_s + KEEP_ALIVE_S
    told = {" ".join(line.split()[2:]) for line in team.log.splitlines()}
    return {
        "blind_s": float(blind_s),
        "turned_s": turned_s,
        "woke": bool(after_waking),
        "exceeded": bool(blind_s > limit_s or (turned_s or 0.0) > limit_s or after_waking),
        "error": truth[-1]["shape_error"],
        "formed": truth[-1]["shape_error"] < FORMED,
        "different": different,
        "unfinished": unread,
        "lost_s": float(lost_s),
        "killed_at_end": team.log.count("was killed"),
        "told": sorted(told),
    }


def table(rows: list[dict[str, Any]]) -> str:
    """Return a Markdown table with one line a fault."""
    return fault_table(
        rows,
        {
            "longest blind, s": lambda here: f"{max(row['blind_s'] for row in here):.2f}",
            **STOP_COLUMNS,
            "moved off": lambda here: sum(row["exceeded"] for row in here),
            "formed": lambda here: sum(row["formed"] for row in here),
            "lost, s": lambda here: f"{max(row['lost_s'] for row in here):.2f}",
            "replayed otherwise": lambda here: sum(row["different"] for row in here),
            "left": lambda here: sum(len(row["left"]) + row["others"] for row in here),
            "code": lambda here: sum(row["wrong_code"] for row in here),
        },
    )


def run_in_new_folder(fault: str, seed: int) -> dict[str, Any]:
    """Run once in a new folder, and remove its recordings after they were read."""
    with tempfile.TemporaryDirectory() as folder:
        return run(fault, seed, Path(folder))


if __name__ == "__main__":
    measure(__doc__, FAULTS, run_in_new_folder, table)
