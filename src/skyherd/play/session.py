"""Session of `skyherd play`: the running loop, and the operator's requests to it.

The thread that iterates `Session.steps` owns all state. Other threads only call `Session.ask`.
"""

from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from copy import deepcopy
from dataclasses import dataclass
from pathlib import Path
from queue import Empty, SimpleQueue
from time import monotonic
from typing import Self

from skyherd.datasets import (
    Intervention,
    Mission,
    ScenarioSource,
    apply_settings,
    make_mission,
    read_scenario,
)
from skyherd.errors import InputError, OutputError
from skyherd.files.new_file import write_new_file
from skyherd.loop import Step, run_steps
from skyherd.play.changes import Table, dated, merged, restoring, target_of
from skyherd.play.saved import saved_text

MAX_DURATION_S = 86_400.0
"""Simulated time after which a session stands still, s. Derived: the longest run that a scenario may have."""

MAX_INTERVENTIONS = 10_000
"""Interventions of a session, those of the scenario included. Derived: the limit of scenario files."""

LATE_S = 0.5
"""Delay behind the chosen speed that is not caught up, s. Chosen: no visible rush after a slow image."""

ONE_TOUCH_S = 1.0
"""Time between two changes of one value that are undone together, s. Chosen: a slider being dragged."""

MAX_UNDONE = 100
"""Changes that can be undone. Chosen: more than an operator remembers."""


@dataclass(frozen=True)
class Pause:
    """Request to stand still, or to go on."""

    is_paused: bool


@dataclass(frozen=True)
class SingleStep:
    """Request for one step, after which the session stands still."""


@dataclass(frozen=True)
class SetSpeed:
    """Request for a speed, in simulated seconds a second; None for as fast as possible."""

    factor: float | None


@dataclass(frozen=True)
class Restart:
    """Request to begin again with a seed, without the operator's interventions."""

    seed: int


@dataclass(frozen=True)
class Change:
    """Request for interventions, as tables without a time; they are made before the next step."""

    tables: tuple[Table, ...]


@dataclass(frozen=True)
class Undo:
    """Request to restore the values before the last change."""


@dataclass(frozen=True)
class Save:
    """Request to write the session as a scenario file."""


@dataclass(frozen=True)
class End:
    """Request to end the session."""


Request = Pause | SingleStep | SetSpeed | Restart | Change | Undo | Save | End


@dataclass(frozen=True)
class Touch:
    """One change that can be undone.

    Attributes:
        what: targets and keys that were changed.
        before: interventions that restore the values before it.
        at_s: time of its last part, by the clock of the computer.
    """

    what: frozenset[tuple[tuple[str, int], str]]
    before: tuple[Table, ...]
    at_s: float


class Session:
    """A simulation that an operator steers while it runs.

    Attributes:
        mission: the mission with all interventions so far.
        seed: seed of the present run.
        is_paused: whether it stands still.
        speed: simulated seconds a second; None for as fast as possible.
        added: the operator's interventions since the start or the last restart.

    Args:
        source: the scenario, whose tree is complete.
        origins: command-line options that set values, by dotted key; error messages name them.
        folder: existing folder for saved scenarios.
        speed: as the attribute.

    Raises:
        InputError: the scenario is invalid; one line for each problem.
    """

    def __init__(
        self,
        source: ScenarioSource,
        *,
        origins: Mapping[str, str] | None = None,
        folder: Path,
        speed: float | None = 1.0,
    ) -> None:
        self.source, self._origins, self._folder = source, dict(origins or {}), folder
        self.own_duration_s = self._make(source.tree).scenario.duration_s
        self.seed, self.speed, self.is_paused = int(source.tree.get("seed", 1)), speed, False
        self.added: list[Intervention] = []
        self.mission = self._made(self.seed)
        self._requests: SimpleQueue[Request] = SimpleQueue()
        self._pending: list[Table] = []
        self._touches: deque[Touch] = deque(maxlen=MAX_UNDONE)
        self._listeners: list[Callable[[str], None]] = []
        self._step: Step | None = None
        self._is_over = self._is_ended = False
        self._steps_due = 0
        self._due_s = 0.0

    @classmethod
    def open(
        cls,
        name_or_file: str,
        settings: Iterable[str] = (),
        *,
        seed: int | None = None,
        folder: Path,
        speed: float | None = 1.0,
    ) -> Self:
        """Open a built-in scenario or a TOML file, with settings as `load_mission` takes them.

        Raises:
            InputError: the scenario or a setting is invalid, or the folder does not exist.
        """
        source = read_scenario(name_or_file)
        origins = apply_settings(source.tree, settings, "control.k=0.2", "skyherd scenario schema")
        if seed is not None:
            source.tree["seed"] = seed
            origins["seed"] = "seed"
        if not folder.is_dir():
            raise InputError(str(folder), "no such folder", "an existing folder for saved scenarios")
        return cls(source, origins=origins, folder=folder, speed=speed)

    def ask(self, request: Request) -> None:
        """Ask for something; may be called from any thread, and returns at once."""
        self._requests.put(request)

    def listen(self, listener: Callable[[str], None]) -> None:
        """Call a function with a line of text after each request; the line is empty if all is well.

        The function runs in the thread that iterates `steps`.
        """
        self._listeners.append(listener)

    @property
    def can_undo(self) -> bool:
        """True if there is a change to undo."""
        return bool(self._touches)

    def steps(self) -> Iterator[Step]:
        """Yield the steps of the loop in their time, from the start again after each restart.

        The iterator ends after the request `End` only. Requests are handled between two steps.
        """
        while not self._is_ended:
            self._is_over, self._due_s = False, monotonic()
            for step in run_steps(self.mission, requests=self._take):
                self._step = step
                yield step
                self._wait()
                if self._is_over:
                    break
            else:
                self.is_paused = True
                self._tell("the session has reached its longest time; restart or save it")
                while not self._is_over:
                    self._handle(self._requests.get())

    def _make(self, tree: Mapping[str, object]) -> Mission:
        source = self.source
        return make_mission(dict(tree), where=source.where, folder=source.folder, origins=self._origins)

    def _made(self, seed: int) -> Mission:
        """Return the mission of an endless run with a seed."""
        return self._make({**deepcopy(self.source.tree), "seed": seed, "duration_s": MAX_DURATION_S})

    def _tell(self, line: str) -> None:
        for listener in self._listeners:
            listener(line)

    def _wait(self) -> None:
        """Handle requests until the next step is due."""
        self._steps_due = max(0, self._steps_due - 1)
        step_s = self.mission.scenario.step_s
        self._due_s = max(self._due_s, monotonic() - LATE_S) + (step_s / self.speed if self.speed else 0.0)
        while not self._is_over:
            is_held = self.is_paused and not self._steps_due
            left_s = None if is_held else self._due_s - monotonic() if self.speed else 0.0
            try:
                if left_s is None or left_s > 0:
                    self._handle(self._requests.get(timeout=left_s))
                else:
                    self._handle(self._requests.get_nowait())
            except Empty:
                return
            if self._steps_due:
                return

    def _handle(self, request: Request) -> None:
        """Carry out a request, and report its outcome."""
        line = ""
        try:
            match request:
                case Pause():
                    self.is_paused = request.is_paused
                case SingleStep():
                    self.is_paused, self._steps_due = True, 1
                case SetSpeed():
                    self.speed, self._due_s = request.factor, monotonic()
                case Restart():
                    self._restart(request.seed)
                case Change():
                    self._change(request.tables)
                case Undo():
                    line = self._undo()
                case Save():
                    line = f"saved as {self._save()}"
                case End():
                    self._is_over = self._is_ended = True
        except InputError as error:
            line = "; ".join(error.lines)
        except OutputError as error:
            line = str(error)
        self._tell(line)

    def _restart(self, seed: int) -> None:
        self.mission = self._made(seed)
        self.seed, self.added, self._pending = seed, [], []
        self._touches.clear()
        self._is_over = True

    def _change(self, tables: Sequence[Table]) -> None:
        """Keep changes for the next step, if they are possible then."""
        self._check(tables)
        before = tuple(restoring(table, self.mission, self._now) for table in tables)
        self._pending = merged(self._pending, tables)
        what = frozenset((target_of(table), key) for table in tables for key in table)
        last = self._touches[-1] if self._touches else None
        if last and last.what == what and monotonic() - last.at_s < ONE_TOUCH_S:
            before = last.before
            self._touches.pop()
        self._touches.append(Touch(what, before, monotonic()))

    def _undo(self) -> str:
        if not self._touches:
            return "nothing to undo"
        tables = self._touches[-1].before
        self._check(tables)
        self._pending = merged(self._pending, tables)
        self._touches.pop()
        return ""

    def _check(self, tables: Sequence[Table]) -> None:
        """Check that changes are possible at the next step.

        Raises:
            InputError: a change is impossible.
        """
        if len(self.mission.scenario.interventions) + len(self._pending) + len(tables) > MAX_INTERVENTIONS:
            raise InputError(
                "interventions", f"more than {MAX_INTERVENTIONS}", "restart, or save this session"
            )
        time_s = self._now.time_s + self.mission.scenario.step_s
        self.mission.with_interventions(dated(merged(self._pending, tables), time_s))

    @property
    def _now(self) -> Step:
        if self._step is None:
            raise ValueError("requests are handled after the first step")
        return self._step

    def _take(self, time_s: float) -> Sequence[Intervention]:
        """Return the waiting changes as interventions of the step at a time, s."""
        taken = dated(self._pending, time_s)
        self._pending = []
        self.mission = self.mission.with_interventions(taken)
        self.added += taken
        return taken

    def _save(self) -> Path:
        """Write the session as a scenario into a new file, and return its path."""
        text = saved_text(
            self.source,
            seed=self.seed,
            duration_s=max(self.own_duration_s, self._now.time_s),
            added=self.added,
        )
        return write_new_file(self._folder, f"{self.mission.scenario.name}-played", ".toml", text)
