"""`skyherd unit`, `skyherd robot` and `skyherd world`: single processes of a live team."""

import os
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from skyherd.cli.console import say
from skyherd.cli.interrupts import EndRequest, SignalReceived, signals_as_requests
from skyherd.cli.live import Insecure, LabFile, Settings, joined_team
from skyherd.cli.options import Scenario
from skyherd.errors import InputError

if TYPE_CHECKING:
    from skyherd.live.process_context import ProcessContext

Out = Annotated[Path, typer.Option("--out", metavar="DIR", help="Record into this folder.")]
Supervised = Annotated[bool, typer.Option("--supervised", help="End when the standard input ends.")]
Offset = Annotated[
    float, typer.Option("--clock-offset", metavar="SECONDS", help="Shift the clock, for tests.")
]


def _read_to_end(request: EndRequest) -> None:
    """Read standard input until the process at its other end is gone, then request the end."""
    with suppress(OSError):
        while os.read(sys.stdin.fileno(), 4096):
            pass
    request.ask()


class Crash(Exception):
    """Error of a supervised process other than refused input. It ends the program with code 1."""


@contextmanager
def _crashing(supervised: bool) -> Iterator[None]:
    """Turn all errors of a supervised process except InputError into a crash, after which it is restarted.

    The command line ends with code 2 after OSError and MemoryError, and with any code after SystemExit. The
    supervisor does not restart a process with such a code. Causes such as a lack of file descriptors pass.
    """
    try:
        yield
    except (InputError, SignalReceived):
        raise
    except BaseException as error:
        if not supervised:
            raise
        raise Crash(f"{type(error).__name__}: {error}") from error


def _tell(line: str) -> None:
    say(line)
    sys.stdout.flush()


@contextmanager
def _process(
    lab_file: str,
    name: str,
    folder: Path,
    settings: list[str] | None,
    insecure: bool,
    supervised: bool,
    clock_offset_s: float,
    *,
    dry_run: bool,
) -> "Iterator[tuple[ProcessContext, EndRequest]]":
    """Provide the context of a unit or robot of this name until a signal requests the end."""
    from skyherd.live.live_clock import LiveClock
    from skyherd.live.process_context import ProcessContext

    clock = LiveClock(clock_offset_s)
    with joined_team(lab_file, settings, insecure) as (lab, radio), signals_as_requests() as request:
        lab.check_process(name)
        if supervised:
            threading.Thread(target=_read_to_end, args=[request], daemon=True).start()
        context = ProcessContext(
            lab, radio, clock, folder, _tell, request.is_asked, supervised=supervised, dry_run=dry_run
        )
        with context.claimed(name):
            yield context, request


def unit(
    lab_file: LabFile,
    number: Annotated[int, typer.Argument(metavar="UNIT", min=0, help="Number of the unit, such as 0.")],
    out_dir: Out = Path("runs/live"),
    camera: Annotated[
        str | None, typer.Option(metavar="ADDRESS", help="Use this camera instead of the lab's.")
    ] = None,
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Do not send flight commands.")] = False,
    preview: Annotated[
        bool, typer.Option("--preview", help="Write pictures for the page of `skyherd live run`.")
    ] = False,
    settings: Settings = None,
    insecure: Insecure = False,
    supervised: Supervised = False,
    clock_offset_s: Offset = 0.0,
) -> int:
    """Run one aerial unit of a lab until Ctrl-C: its camera in, goals for its robots out."""
    name = f"unit/{number}"
    with (
        _crashing(supervised),
        _process(
            lab_file, name, out_dir, settings, insecure, supervised, clock_offset_s, dry_run=dry_run
        ) as (context, end),
    ):
        from skyherd.live.unit_process import run_unit

        run_unit(context, number, address=camera, previews=preview)
    return end.exit_code


def robot(
    lab_file: LabFile,
    marker: Annotated[int, typer.Argument(metavar="ROBOT", min=0, help="Marker of the robot, such as 3.")],
    out_dir: Out = Path("runs/live"),
    dry_run: Annotated[
        bool, typer.Option("--dry-run", help="Print the commands instead of sending them.")
    ] = False,
    settings: Settings = None,
    insecure: Insecure = False,
    supervised: Supervised = False,
    clock_offset_s: Offset = 0.0,
) -> int:
    """Run one robot process. It starts disarmed and stops on Ctrl-C."""
    name = f"robot/{marker}"
    with (
        _crashing(supervised),
        _process(
            lab_file, name, out_dir, settings, insecure, supervised, clock_offset_s, dry_run=dry_run
        ) as (context, end),
    ):
        from skyherd.live.robot_process import run_robot

        run_robot(context, marker)
    return end.exit_code


def world(
    scenario: Scenario,
    lab_file: Annotated[
        str | None,
        typer.Option(
            "--lab",
            metavar="LAB",
            show_default="the lab named as the scenario",
            help="Use the radio and the team of this lab.",
        ),
    ] = None,
    speed: Annotated[
        float, typer.Option(metavar="FACTOR", min=0.01, max=10, help="Simulated time over real time.")
    ] = 1.0,
    settings: Annotated[
        list[str] | None, typer.Option("--set", metavar="KEY=VALUE", help="Replace a value of the scenario.")
    ] = None,
    record: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Record the truth into this MCAP file.")
    ] = None,
    port: Annotated[
        int, typer.Option(metavar="N", min=1, max=65000, help="TCP port of the first camera.")
    ] = 7461,
    insecure: Insecure = False,
) -> int:
    """Run the world of a scenario in real time: streams of its cameras out, wheel commands in."""
    from skyherd.datasets import load_mission
    from skyherd.live.name_locks import hold_name
    from skyherd.live.world.process import run_world

    mission = load_mission(scenario, settings or [])
    with (
        joined_team(lab_file or mission.scenario.name, None, insecure) as (lab, radio),
        signals_as_requests() as request,
        hold_name(lab, "world"),
    ):
        run_world(
            mission,
            radio,
            team=lab.model.team,
            speed=speed,
            path=record,
            first_port=port,
            tell=_tell,
            ended=request.is_asked,
        )
    return request.exit_code
