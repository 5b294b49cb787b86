"""`skyherd live`: check, run, arm and stop a lab of real cameras and robots, and repeat its decisions."""

import json
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from skyherd.cli.console import say, say_table, warn
from skyherd.cli.interrupts import signals_as_requests
from skyherd.cli.options import DEFAULT_PORT, LOOPBACK, Duration, PageHost, PagePort

if TYPE_CHECKING:
    from skyherd.live.lab import Lab
    from skyherd.live.lab.camera_survey import CameraSurvey, Finding
    from skyherd.live.mailbox import Radio
    from skyherd.live.operator import Outcome

live_app = typer.Typer(help="Real cameras and robots: check, run, arm and stop a lab.", rich_markup_mode=None)

LabFile = Annotated[
    str, typer.Argument(metavar="LAB", help="A built-in lab, such as webcams, or a TOML file.")
]
Insecure = Annotated[
    bool,
    typer.Option(
        "--insecure", help="Allow a radio beyond this machine without TLS. Anyone on the network can drive."
    ),
]
Settings = Annotated[
    list[str] | None,
    typer.Option("--set", metavar="KEY=VALUE", help="Replace a value of the lab, such as control.k=0.2."),
]


@live_app.command()
def show(
    name: Annotated[
        str | None, typer.Argument(metavar="NAME", help="A built-in lab. Without it, all are listed.")
    ] = None,
) -> None:
    """Print an example of a lab file, to be saved and changed."""
    from skyherd.live.lab import lab_names, lab_text

    typer.echo(lab_text(name) if name else "\n".join(lab_names()), nl=not name)


@live_app.command()
def schema() -> None:
    """Print the JSON schema of lab files."""
    from skyherd.live.lab import LabModel

    typer.echo(json.dumps(LabModel.model_json_schema(), indent=2))


@live_app.command()
def check(
    lab_file: LabFile,
    no_cameras: Annotated[
        bool, typer.Option("--no-cameras", help="Check only the file. Do not open the cameras.")
    ] = False,
    seconds: Annotated[
        float, typer.Option(metavar="S", min=0.1, max=600, help="Watch each camera for this time.")
    ] = 2.0,
    settings: Settings = None,
) -> int:
    """Check a lab file, and watch every camera: coverage, overlap, marker sizes, light and blur.

    Move robots by hand meanwhile to see the blur of motion. Exit code 0 if all is well, 2 if there is a
    problem.
    """
    from skyherd.live.lab import check_drivers, load_lab
    from skyherd.live.lab.camera_survey import team_findings

    lab = load_lab(lab_file, settings or [])
    check_drivers(lab.model, lab_file, imports=True)
    for unit in range(len(lab.model.cameras)):
        lab.calibration(unit)
    radio = lab.model.radio
    if not radio.is_secured:
        warn("radio: reaches beyond this machine without TLS: `live run` asks for --insecure")
    good = f"{len(lab.ids)} robots, {len(lab.model.cameras)} camera(s)"
    if no_cameras:
        say(f"{lab_file}: good: {good}")
        return 0
    surveys = [survey for unit in range(len(lab.model.cameras)) if (survey := _survey(lab, unit, seconds))]
    fine = len(surveys) == len(lab.model.cameras)
    if surveys:
        fine &= _say_findings(team_findings(lab, [survey.seen.keys() for survey in surveys]))
    fine &= all(survey.is_fine for survey in surveys)
    say(f"{lab_file}: good: {good}" if fine else f"{lab_file}: {good}, with problems")
    return 0 if fine else 2


def _survey(lab: "Lab", unit: int, seconds: float) -> "CameraSurvey | None":
    """Watch a camera, and print the results; return None if it shows nothing."""
    from skyherd.errors import InputError
    from skyherd.live.lab.camera_survey import watch_camera

    try:
        survey = watch_camera(lab, unit, seconds)
    except InputError as error:
        say(f"camera {unit}: {error}")
        return None
    width, height = survey.size_px
    say(f"camera {unit}: {width}x{height} px, {survey.images} images")
    _say_findings(survey.findings())
    return survey


def _say_findings(findings: "Iterable[Finding]") -> bool:
    """Print findings, one a line; return whether none is a problem."""
    from skyherd.live.lab.camera_survey import Level

    fine = True
    for finding in findings:
        say(f"  {finding.level.value:8}{finding.text}")
        fine &= finding.level is not Level.PROBLEM
    return fine


@live_app.command()
def run(
    lab_file: LabFile,
    out_dir: Annotated[
        Path | None,
        typer.Option(
            "--out", metavar="DIR", show_default="runs/TEAM-TIME", help="Record into this new folder."
        ),
    ] = None,
    cameras: Annotated[
        str | None, typer.Option(metavar="ADDRESSES", help="Use these cameras instead, with commas between.")
    ] = None,
    dry_run: Annotated[
        bool, typer.Option("--dry-run", help="Print the commands instead of sending them.")
    ] = False,
    armed: Annotated[
        bool, typer.Option("--arm", help="Arm the robots as soon as all are connected.")
    ] = False,
    duration_s: Duration = None,
    with_page: Annotated[
        bool, typer.Option("--page", help="Show images and states on a page, with a stop button.")
    ] = False,
    port: PagePort = DEFAULT_PORT,
    host: PageHost = LOOPBACK,
    settings: Settings = None,
    insecure: Insecure = False,
) -> int:
    """Start every unit and robot of a lab on this machine, and keep them running until Ctrl-C.

    Robots are disarmed: `skyherd live arm`, or the key a. The space bar stops them.
    """
    from skyherd.live.cockpit import PageAddress
    from skyherd.live.lab import load_lab
    from skyherd.live.line_writer import leave_if_held
    from skyherd.live.session import run_session

    lab = load_lab(lab_file, settings or [])
    page = PageAddress(host, port) if with_page else None
    if page is not None and host != LOOPBACK:
        warn(f"the page can be reached at {host}, without encryption; its address is a password")
    with signals_as_requests() as request:
        code = run_session(
            lab,
            lab_file,
            out_dir,
            cameras=[] if cameras is None else cameras.split(","),
            dry_run=dry_run,
            armed=armed,
            duration_s=duration_s,
            settings=settings or [],
            insecure=insecure,
            page=page,
            say=say,
            ended=request.is_asked,
        )
    leave_if_held(request.exit_code or code)
    return request.exit_code or code


@live_app.command()
def arm(
    lab_file: LabFile,
    robots: Annotated[
        list[int] | None,
        typer.Option("--robot", metavar="ID", help="Arm this robot alone; may be given several times."),
    ] = None,
    settings: Settings = None,
    insecure: Insecure = False,
) -> int:
    """Arm all robots of a running lab, which units have to see. Exit code 1 if some robot is not armed.

    Arm each robot alone at first, and watch whether it drives towards its goal: exchanged markers and
    reversed wheels are not noticed. A stop that is given after the command is not cleared, also while the
    command is still starting.
    """
    from skyherd.live import operator
    from skyherd.live.live_clock import LiveClock
    from skyherd.version import STARTED_S

    with joined_team(lab_file, settings, insecure) as (lab, radio):
        watched = operator.watch(lab, radio, LiveClock())
        for robot in robots or []:
            lab.robot(robot)
        return _report("armed", operator.arm(lab, watched, given_s=STARTED_S, robots=robots or None))


@live_app.command()
def stop(lab_file: LabFile, settings: Settings = None, insecure: Insecure = False) -> int:
    """Stop and disarm all robots of a running lab until they are armed again.

    Units send no goals meanwhile, so that a robot that misses the stop stands still within
    `limits.goal_timeout_s`. Exit code 1 if some robot did not confirm the stop.
    """
    from skyherd.live import operator
    from skyherd.live.live_clock import LiveClock

    with joined_team(lab_file, settings, insecure) as (lab, radio):
        watched = operator.watch(lab, radio, LiveClock())
        return _report("stopped", operator.stop(lab, watched, "skyherd live stop"))


def _report(word: str, outcome: "Outcome") -> int:
    """Print the result of a command; return 1 if some robot did not confirm it, else 0."""
    from skyherd.live.session import outcome_lines

    for line in outcome_lines(word, outcome):
        say(line)
    return int(not outcome.is_complete)


@live_app.command()
def replay(
    folder: Annotated[
        Path,
        typer.Argument(
            metavar="DIR|FILE",
            help="A folder of `skyherd live run`, or a file of it, such as runs/lab/robot-3.mcap.",
        ),
    ],
) -> int:
    """Repeat the decisions of each process from its recording; exit code 1 if any bit differs."""
    from skyherd.errors import InputError
    from skyherd.live.logs.replay import replay as replay_file
    from skyherd.live.review import recorded_files

    files = recorded_files(folder) if folder.is_dir() else [folder]
    if not files:
        raise InputError(str(folder), "no recordings of units or robots", "a folder of `skyherd live run`")
    rows, same = [], True
    for path in files:
        found = replay_file(path)
        same &= found.different == 0
        verdict = "same" if not found.different else f"{found.different} differ, first at {found.first_s}"
        rows.append((path.name, str(found.decisions), verdict, "yes" if found.ended else "no"))
    say_table(("file", "decisions", "repeated", "ended"), rows, right_aligned={"decisions"})
    return 0 if same else 1


@contextmanager
def joined_team(lab_file: str, settings: list[str] | None, insecure: bool) -> "Iterator[tuple[Lab, Radio]]":
    """Provide the lab and its radio, and leave the radio at the end."""
    from skyherd.live.lab import load_lab
    from skyherd.live.zenoh_radio import ZenohRadio

    lab = load_lab(lab_file, settings or [])
    radio = ZenohRadio(lab.model.radio, lab.folder, insecure=insecure)
    try:
        yield lab, radio
    finally:
        radio.close()
