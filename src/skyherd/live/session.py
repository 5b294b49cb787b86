"""`skyherd live run`: every process of a lab on this machine, one log, and a dashboard with a stop."""

import math
import os
import select
import sys
import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from rich.console import Console, Group
from rich.live import Live
from rich.table import Table
from rich.text import Text

from skyherd.errors import InputError
from skyherd.live import operator
from skyherd.live.cameras import check_camera
from skyherd.live.lab import Lab, check_drivers
from skyherd.live.live_clock import LiveClock
from skyherd.live.supervisor import WRONG, Supervisor
from skyherd.live.zenoh_radio import ZenohRadio
from skyherd.text import printable

REFRESH_HZ = 4.0
"""How often the dashboard is drawn anew, 1/s."""

MAX_KEYS = 1024
"""Keys that are read at a time. Chosen: more than anybody presses within a drawing of the dashboard."""

LINES = 12
"""Lines of the log that the dashboard shows."""


def run_session(
    lab: Lab,
    lab_file: str,
    folder: Path | None,
    *,
    cameras: Sequence[str],
    dry_run: bool,
    armed: bool,
    duration_s: float | None,
    settings: Sequence[str],
    insecure: bool,
    say: Callable[[str], None],
) -> int:
    """Run a lab until Ctrl-C, the end of its videos, or `duration_s`, and while units and robots are left.

    Args:
        lab: the set-up.
        lab_file: where it was read from, for the processes.
        folder: where everything is recorded; made, and must not be there.
        cameras: addresses in place of the lab's.
        dry_run: nothing is sent to robots.
        armed: arm as soon as all robots are there.
        duration_s: end after so long.
        settings: what was put over the lab, for the processes.
        insecure: allow a radio beyond this machine without TLS.
        say: prints a line.

    Returns:
        The exit code: that of processes which were given what is wrong, if there were any, and else 0.

    Raises:
        InputError: a camera is not there or a driver cannot be, the folder is there, an address in place of
            a camera's is empty, there are more or fewer of them than cameras, or the duration is none.
    """
    _check_options(lab, cameras, duration_s)
    _check_addresses(lab, lab_file, cameras, dry_run=dry_run)
    radio = ZenohRadio(lab.model.radio, lab.folder, insecure=insecure)
    try:
        folder = _make_folder(folder, lab)
    except InputError:
        radio.close()
        raise
    console = Console()
    lines: deque[str] = deque(maxlen=LINES)
    shows = console.is_terminal
    supervisor = Supervisor(folder / "live.log", lines.append if shows else say)
    watched = operator.watch(lab, radio, LiveClock(), "supervisor")
    options = _process_options(folder, settings, insecure=insecure, dry_run=dry_run)
    end_s = float("inf") if duration_s is None else time.monotonic() + duration_s
    waiting_to_arm = armed
    try:
        _start_all(supervisor, lab, lab_file, cameras, options)
        with _keys() as key, _display(console if shows else None) as draw:
            while time.monotonic() < end_s and not _gone(supervisor):
                supervisor.tend()
                watched.listen(1 / REFRESH_HZ)
                waiting_to_arm = _obey(key(), lab, watched, supervisor, waiting_to_arm=waiting_to_arm)
                draw(_page(lab, watched, supervisor, lines))
    except KeyboardInterrupt:
        supervisor.say("live", "interrupted")
    finally:
        operator.stop(lab, watched, "the end", 0.3)
        last_words = _last_words(supervisor)
        for line in last_words:
            supervisor.say("live", line)
        supervisor.end()
        radio.close()
    for line in last_words if shows else []:
        say(line)
    say(f"recorded in {folder}; `skyherd report {folder}` makes a page of it")
    return WRONG if supervisor.refused else 0


def _obey(
    pressed: str, lab: Lab, watched: operator.Watch, supervisor: Supervisor, *, waiting_to_arm: bool
) -> bool:
    """Stop or arm as a key says, or as all robots are there; whether to go on waiting to arm."""
    if pressed == " ":
        _report(supervisor, "stopped", operator.stop(lab, watched, "space bar", 1.0))
        return False
    if pressed == "a" or (waiting_to_arm and _all_there(lab, watched)):
        outcome = operator.arm(lab, watched, 2.0)
        _report(supervisor, "armed", outcome)
        return waiting_to_arm and bool(outcome.missing)
    return waiting_to_arm


def _process_options(folder: Path, settings: Sequence[str], *, insecure: bool, dry_run: bool) -> list[str]:
    """Options that all processes of a run are started with."""
    options = ["--out", str(folder), "--supervised", *["--insecure"] * insecure, *["--dry-run"] * dry_run]
    return options + [part for setting in settings for part in ("--set", setting)]


def _gone(supervisor: Supervisor) -> str:
    """What a lab needs and no longer has: its last unit or robot has ended for good. Empty if it has both."""
    return next(
        (f"no {kind} is left" for kind in ("unit", "robot") if not supervisor.goes_on(f"{kind}/")), ""
    )


def _last_words(supervisor: Supervisor) -> list[str]:
    """Why a run ends, and which processes were given what is wrong."""
    refused = ", ".join(supervisor.refused)
    words = f"ended with code {WRONG}: {refused}; live.log says what is wrong" if refused else ""
    return [line for line in (_gone(supervisor), words) if line]


def _check_addresses(lab: Lab, lab_file: str, cameras: Sequence[str], *, dry_run: bool) -> None:
    """Refuse cameras that are not on this machine, and drivers that cannot be; see `run_session`."""
    if not dry_run:
        check_drivers(lab.model, lab_file, imports=True)
    for unit, address in enumerate(cameras or [camera.address for camera in lab.model.cameras]):
        try:
            check_camera(address)
        except InputError as error:
            place = f"--cameras: address {unit + 1}" if cameras else f"{lab_file}: cameras.{unit}.address"
            shown = "" if error.where == "camera" else f": {error.where}"
            raise InputError(place + shown, error.what, error.allowed) from None


def _check_options(lab: Lab, cameras: Sequence[str], duration_s: float | None) -> None:
    """Refuse options that mean nothing; see `run_session`."""
    count = len(lab.model.cameras)
    for number, address in enumerate(cameras, 1):
        if not address.strip():
            raise InputError(
                "--cameras",
                f"address {number} is empty",
                f"{count} with commas between, or leave the option out for the lab's own",
            )
    if cameras and len(cameras) != count:
        raise InputError("--cameras", f"{len(cameras)} addresses", f"{count}, as in the lab")
    if duration_s is not None and not (math.isfinite(duration_s) and duration_s > 0):
        raise InputError(
            "--duration",
            f"{duration_s:g}",
            "a number of seconds above 0, or leave it out to run until Ctrl-C",
        )


def _make_folder(folder: Path | None, lab: Lab) -> Path:
    """A new folder for a run: the one that was asked for, or one named after the team and the time."""
    folder = folder or Path("runs") / f"{lab.model.team}-{time.strftime('%Y%m%d-%H%M%S')}"
    try:
        folder.mkdir(parents=True)
    except OSError as error:
        raise InputError(str(folder), error.strerror or str(error), "a folder that is not there") from None
    return folder


def _start_all(
    supervisor: Supervisor, lab: Lab, lab_file: str, cameras: Sequence[str], options: Sequence[str]
) -> None:
    """Start a process for each unit and each robot, all with the same options."""
    for unit in range(len(lab.model.cameras)):
        camera = ["--camera", cameras[unit]] if cameras else []
        supervisor.add(f"unit/{unit}", ["unit", lab_file, str(unit), *camera, *options])
    for robot in lab.ids:
        supervisor.add(f"robot/{robot}", ["robot", lab_file, str(robot), *options])


def _all_there(lab: Lab, watched: operator.Watch) -> bool:
    alive = watched.alive()
    return all(f"robot/{robot}" in alive for robot in lab.ids)


def _report(supervisor: Supervisor, word: str, outcome: operator.Outcome) -> None:
    rest = f"; no answer from {outcome.missing}" if outcome.missing else ""
    supervisor.say("live", f"{word}: {outcome.done or 'none'}{rest}")


def _page(lab: Lab, watched: operator.Watch, supervisor: Supervisor, lines: Sequence[str]) -> Group:
    """The dashboard."""
    alive = watched.alive()
    armed = sum(heartbeat.armed for heartbeat in alive.values())
    table = Table(box=None, header_style="bold")
    for column in ("process", "starts", "armed", "what it says"):
        table.add_column(column)
    for child in supervisor.children:
        heartbeat = alive.get(child.name)
        says = "no sign of life" if heartbeat is None else printable(heartbeat.state)
        mark = "" if heartbeat is None or not heartbeat.session else "ARMED" if heartbeat.armed else "no"
        table.add_row(child.name, str(child.restarts + 1), mark, Text(says))
    head = (
        f"team {lab.model.team}: {armed} of {len(lab.ids)} robots armed.  a: arm   space: STOP   Ctrl-C: end"
    )
    return Group(Text(head, style="bold"), table, Text("\n".join(lines)))


@contextmanager
def _display(console: Console | None) -> Iterator[Callable[[Group], None]]:
    """A place to draw the dashboard; nowhere without a terminal."""
    if console is None:
        yield lambda page: None
        return
    with Live(console=console, refresh_per_second=REFRESH_HZ, screen=True) as live:
        yield live.update


@contextmanager
def _keys() -> Iterator[Callable[[], str]]:
    """The key that was pressed since the last call, or an empty text; none without a terminal.

    Of several keys the last one counts, unless the space bar is among them: a stop is never lost. They are
    read past Python's buffer, in which `select` would not see those that came together with another.
    """
    if not sys.stdin.isatty() or sys.platform == "win32":
        yield lambda: ""
        return
    import termios
    import tty

    before = termios.tcgetattr(sys.stdin)
    tty.setcbreak(sys.stdin)

    def pressed() -> str:
        ready, _, _ = select.select([sys.stdin], [], [], 0)
        keys = os.read(sys.stdin.fileno(), MAX_KEYS).decode(errors="replace") if ready else ""
        return " " if " " in keys else keys[-1:]

    try:
        yield pressed
    finally:
        termios.tcsetattr(sys.stdin, termios.TCSADRAIN, before)
