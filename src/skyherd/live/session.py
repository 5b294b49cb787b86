"""`skyherd live run`: all processes of a lab on this machine, with one log and a dashboard."""

import math
import time
from collections import deque
from collections.abc import Callable, Sequence
from pathlib import Path

from rich.console import Console, Group
from rich.table import Table
from rich.text import Text

from skyherd.errors import InputError
from skyherd.live import operator
from skyherd.live.cameras import check_camera
from skyherd.live.cockpit import PREVIEWS, Cockpit, PageAddress, ProcessState
from skyherd.live.lab import Lab, check_drivers
from skyherd.live.live_clock import LiveClock
from skyherd.live.name_locks import hold_name
from skyherd.live.operator import ArmCommand, Command, StopCommand, Watch
from skyherd.live.process_context import HEARTBEAT_S
from skyherd.live.screen import Screen
from skyherd.live.supervisor import WRONG, Supervisor
from skyherd.live.terminal_keys import SUSPEND, terminal_keys
from skyherd.live.wire import SESSION, Heartbeat
from skyherd.live.zenoh_radio import ZenohRadio
from skyherd.text import printable

REFRESH_S = 0.25
"""Longest wait for messages before keys are read again, s. Chosen: the refresh period of the dashboard."""

LINES = 12
"""Number of log lines on the dashboard."""


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
    page: PageAddress | None = None,
    say: Callable[[str], None],
    ended: Callable[[], bool],
) -> int:
    """Run a lab until `ended()`, its duration is over, or no unit or no robot is left.

    Args:
        lab: the set-up.
        lab_file: file of the lab, which the processes read too.
        folder: new folder of all recordings; it must not exist.
        cameras: camera addresses that replace those of the lab.
        dry_run: send nothing to robots.
        armed: arm the robots once all of them are ready.
        duration_s: duration of the run, or None.
        settings: settings that override the lab, passed on to the processes.
        insecure: allow a radio beyond this machine without TLS.
        page: address of a page with the state of the run and a stop button, or None.
        say: prints a line.
        ended: called several times a second; True ends the run. Signals act only through it, so that repeated
            signals do not interrupt the shutdown.

    Returns:
        The exit code: 2 if a process refused its input, 1 if a process survives, else 0.

    Raises:
        InputError: a camera, its calibration, a driver or the page's address cannot be used, or the folder
            exists. An address in `cameras` is empty, or their number differs from the lab's cameras. The
            duration is not positive. Another process on this machine runs the team.
    """
    _check_options(lab, cameras, duration_s)
    _check_addresses(lab, lab_file, cameras, dry_run=dry_run)
    with hold_name(lab, "live run"), terminal_keys() as key:
        radio = ZenohRadio(lab.model.radio, lab.folder, insecure=insecure)
        try:
            folder = _make_folder(folder, lab)
            cockpit = _open_cockpit(lab, folder, page)
        except InputError:
            radio.close()
            raise
        if cockpit.url:
            say(f"open {cockpit.url}")
        console = Console()
        lines: deque[str] = deque(maxlen=LINES)
        screen = Screen(console if console.is_terminal else None, say)

        def tell(line: str) -> None:
            lines.append(line)
            screen.tell(line)

        supervisor = Supervisor(folder / "live.log", tell)
        watched = operator.watch(lab, radio, LiveClock(), SESSION)
        session = Session(lab, watched, supervisor.say, arms=armed)
        options = _process_options(folder, settings, insecure=insecure, dry_run=dry_run)
        end_s = float("inf") if duration_s is None else time.monotonic() + duration_s
        try:
            _start_all(supervisor, lab, lab_file, cameras, options, previews=page is not None)
            while not ended() and time.monotonic() < end_s and not _end_reason(supervisor):
                supervisor.tend()
                session.step(key(), REFRESH_S, page_stops=cockpit.stop_asked())
                processes = _processes(watched, supervisor)
                screen.draw(_dashboard(lab, watched, processes, lines, cockpit.url))
                cockpit.show(processes, watched, lines)
            if ended():
                supervisor.say("live", "interrupted; ending all processes")
        finally:
            screen.draw(Text("stopping the team and ending all processes"))
            operator.stop(lab, watched, "the end", 0.3)
            closing_lines = _closing_lines(supervisor)
            for line in closing_lines:
                supervisor.say("live", line)
            left = supervisor.end()
            cockpit.close()
            radio.close()
            is_held = not screen.close()
    last_lines = closing_lines if console.is_terminal else []  # They have been printed without a dashboard.
    last_lines += [f"still running: {', '.join(left)}"] if left else []
    last_lines += [f"recorded in {folder}; `skyherd report {folder}` makes a report"]
    for line in [] if is_held else last_lines:
        say(line)
    return WRONG if supervisor.refused else int(bool(left))


class Session:
    """Operator within a run: it handles keys, arms the robots once, and repeats the team's stop number.

    Args:
        lab: the set-up.
        watched: the operator's view of the team.
        tell: called with a process name and a line for people.
        arms: arm the robots once all of them are ready. A stop from any operator cancels that.

    Attributes:
        arms: True while it waits for all robots to be ready.
    """

    def __init__(self, lab: Lab, watched: Watch, tell: Callable[[str, str], None], *, arms: bool) -> None:
        self.arms = arms
        self._lab, self._watched, self._tell = lab, watched, tell
        self._running: tuple[str, Command, float] | None = None
        self._beaten_s = -math.inf
        self._met_other = False
        self._known_stop = watched.latch.stop

    def step(self, pressed: str, timeout_s: float, *, page_stops: bool = False) -> None:
        """Process messages for up to `timeout_s`, handle a key, and continue the current command.

        Args:
            pressed: the key, or an empty string.
            timeout_s: longest wait for the first message.
            page_stops: True if the page asks to stop; it has priority over any key.
        """
        watched = self._watched
        if page_stops or pressed in (" ", SUSPEND):
            why = "page" if page_stops else "space bar" if pressed == " " else "Ctrl-Z"
            if why == "Ctrl-Z":
                self._tell("live", "Ctrl-Z stops the team; a run that moves robots is not suspended")
            self._begin("stopped", StopCommand(self._lab, watched, why), operator.SETTLE_S)
        known = watched.latch
        watched.listen(timeout_s)
        if watched.latch.stop > self._known_stop:
            self._known_stop = watched.latch.stop
            if self.arms:
                self.arms = False
                self._tell("live", "the team was stopped: press a to arm the robots")
        if pressed == "a" and not page_stops:
            self._begin("armed", ArmCommand(self._lab, watched, known), operator.SETTLE_S)
        elif self.arms and self._all_ready():
            self.arms = False
            self._begin("armed", ArmCommand(self._lab, watched), operator.SETTLE_S)
        self._advance()
        if SESSION in watched.signs and not self._met_other:
            self._met_other = True
            self._tell("live", "another `live run` of this team runs on another machine: end one of them")
        if watched.clock() - self._beaten_s >= HEARTBEAT_S:
            # The heartbeat carries the stop number to restarted processes.
            self._beaten_s = watched.clock()
            watched.mailbox.send(Heartbeat({}, "runs the lab", lab=self._lab.digest))

    def _begin(self, word: str, command: Command, settle_s: float) -> None:
        """Begin a command, which replaces the current one."""
        self._running = word, command, self._watched.clock() + settle_s

    def _advance(self) -> None:
        """Continue the current command, and report its result when it is finished."""
        if self._running is None:
            return
        word, command, end_s = self._running
        if command.advance() or self._watched.clock() >= end_s:
            self._running = None
            for line in outcome_lines(word, command.outcome()):
                self._tell("live", line)

    def _all_ready(self) -> bool:
        """Return whether every robot is alive and accepts an arm command."""
        alive = self._watched.alive()
        return all((sign := alive.get(f"robot/{robot}")) and sign.ready for robot in self._lab.ids)


def outcome_lines(word: str, outcome: operator.Outcome) -> list[str]:
    """Return the result of a command as lines: robots that confirmed it, and the state of the others."""
    lines = [f"{word}: {', '.join(map(str, outcome.done)) or 'none'}"]
    lines += [f"NOT {word}: {outcome.failure}"] if outcome.failure else []
    return lines + [f"NOT {word}: robot {robot}: {state}" for robot, state in outcome.missing.items()]


def _process_options(folder: Path, settings: Sequence[str], *, insecure: bool, dry_run: bool) -> list[str]:
    """Return the command line options of all processes of a run."""
    options = ["--out", str(folder), "--supervised", *["--insecure"] * insecure, *["--dry-run"] * dry_run]
    return options + [part for setting in settings for part in ("--set", setting)]


def _end_reason(supervisor: Supervisor) -> str:
    """Return a message if all units or all robots have ended for good, else an empty string."""
    return next(
        (f"no {kind} is left" for kind in ("unit", "robot") if not supervisor.is_active(f"{kind}/")), ""
    )


def _closing_lines(supervisor: Supervisor) -> list[str]:
    """Return the reason why a run ends, and the processes that refused their input."""
    refused = ", ".join(supervisor.refused)
    words = f"ended with code {WRONG}: {refused}; see live.log for the errors" if refused else ""
    return [line for line in (_end_reason(supervisor), words) if line]


def _check_addresses(lab: Lab, lab_file: str, cameras: Sequence[str], *, dry_run: bool) -> None:
    """Refuse cameras that this machine lacks, and invalid drivers; see `run_session`."""
    if not dry_run:
        check_drivers(lab.model, lab_file, imports=True)
    for unit in range(len(lab.model.cameras)):
        lab.calibration(unit)
    for unit, address in enumerate(cameras or [camera.address for camera in lab.model.cameras]):
        try:
            check_camera(address)
        except InputError as error:
            place = f"cameras: address {unit + 1}" if cameras else f"{lab_file}: cameras.{unit}.address"
            shown = "" if error.where == "camera" else f": {error.where}"
            raise InputError(place + shown, error.what, error.allowed) from None


def _check_options(lab: Lab, cameras: Sequence[str], duration_s: float | None) -> None:
    """Refuse invalid options; see `run_session`."""
    count = len(lab.model.cameras)
    for number, address in enumerate(cameras, 1):
        if not address.strip():
            raise InputError(
                "cameras",
                f"address {number} is empty",
                f"{count} with commas between, or leave the option out for the lab's own",
            )
    if cameras and len(cameras) != count:
        raise InputError("cameras", f"{len(cameras)} addresses", f"{count}, as in the lab")
    if duration_s is not None and not (math.isfinite(duration_s) and duration_s > 0):
        raise InputError(
            "duration_s",
            f"{duration_s:g}",
            "a number of seconds above 0, or leave it out to run until Ctrl-C",
        )


def _make_folder(folder: Path | None, lab: Lab) -> Path:
    """Make the folder of a run: the given one, or one named after the team and the time."""
    folder = folder or Path("runs") / f"{lab.model.team}-{time.strftime('%Y%m%d-%H%M%S')}"
    try:
        folder.mkdir(parents=True)
    except OSError as error:
        raise InputError(str(folder), error.strerror or str(error), "a folder that does not exist") from None
    return folder


def _open_cockpit(lab: Lab, folder: Path, page: PageAddress | None) -> Cockpit:
    """Open the page of a run, if it has an address. On failure the new folder is removed."""
    try:
        return Cockpit(lab, folder / PREVIEWS, page)
    except InputError:
        folder.rmdir()
        raise


def _start_all(
    supervisor: Supervisor,
    lab: Lab,
    lab_file: str,
    cameras: Sequence[str],
    options: Sequence[str],
    *,
    previews: bool,
) -> None:
    """Start a process for each unit and each robot with the same options; units write `previews` if asked."""
    of_units = ["--preview"] * previews
    for unit in range(len(lab.model.cameras)):
        camera = ["--camera", cameras[unit]] if cameras else []
        supervisor.add(f"unit/{unit}", ["unit", lab_file, str(unit), *camera, *options, *of_units])
    for robot in lab.ids:
        supervisor.add(f"robot/{robot}", ["robot", lab_file, str(robot), *options])


def _processes(watched: operator.Watch, supervisor: Supervisor) -> list[ProcessState]:
    """Return the states of all processes of the run."""
    alive = watched.alive()
    states = []
    for child in supervisor.children:
        heartbeat = alive.get(child.name)
        says = "no heartbeat" if heartbeat is None else printable(heartbeat.state)
        says = f"two processes are named {child.name}" if watched.is_ambiguous(child.name) else says
        armed = None if heartbeat is None or not heartbeat.session else heartbeat.armed
        states.append(ProcessState(child.name, child.restarts + 1, armed, says))
    return states


def _dashboard(
    lab: Lab, watched: operator.Watch, processes: Sequence[ProcessState], lines: Sequence[str], url: str
) -> Group:
    """Return the dashboard; `url` is the address of the page, if there is one."""
    armed = sum(heartbeat.armed for heartbeat in watched.alive().values())
    table = Table(box=None, header_style="bold")
    for column in ("process", "starts", "armed", "state"):
        table.add_column(column)
    for process in processes:
        mark = "" if process.armed is None else "ARMED" if process.armed else "no"
        table.add_row(process.name, str(process.starts), mark, Text(process.state))
    head = (
        f"team {lab.model.team}: {armed} of {len(lab.ids)} robots armed.  a: arm   space: STOP   Ctrl-C: end"
    )
    below = [f"page: {url}"] if url else []
    return Group(Text(head, style="bold"), table, Text("\n".join([*below, *lines])))
