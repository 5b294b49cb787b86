"""`skyherd view`: a recorded run in 3-D, on a page with a time bar or as one HTML file."""

import os
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from skyherd.cli.console import say, warn
from skyherd.cli.interrupts import telling_of_interrupts
from skyherd.cli.options import DEFAULT_PORT, LOOPBACK, ForceFile, PageHost, PagePort
from skyherd.errors import InputError

if TYPE_CHECKING:
    from skyherd.recording.reader import Recording


def view(
    run: Annotated[
        Path,
        typer.Argument(metavar="RUN", help="A folder of `skyherd run`, such as runs/star, or its recording."),
    ],
    html: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Write the run as one HTML file, and serve no page."),
    ] = None,
    force: ForceFile = False,
    port: PagePort = DEFAULT_PORT,
    host: PageHost = LOOPBACK,
) -> int:
    """Show a recorded run in 3-D in the browser, with a time bar.

    It prints the page's address. Ctrl-C ends it. An HTML file needs neither skyherd nor a network.
    """
    from skyherd.play.extras import require_viser
    from skyherd.runner import RECORDING

    require_viser("view")
    path = run / RECORDING if os.path.isdir(run) else run
    if html is not None and html.suffix.lower() != ".html":
        raise InputError("--html", f"{str(html)!r} is not an HTML file", "a name that ends in .html")
    if html is not None:
        write_replay(path, html, force=force)
        say(f"see {html}")
        return 0
    recording = _read(path)
    from skyherd.play.view_page import ViewPage
    from skyherd.report.access import Access, bind

    with bind(host, port) as listener:
        access = Access.make(host, listener.getsockname()[1])
        if host != LOOPBACK:
            warn(f"the page can be reached at {host}, without encryption; its address is a password")
        page = ViewPage(recording.mission, recording.steps, access, listener)
        say(f"open {access.url}")
        try:
            with telling_of_interrupts("the recording is as it was"):
                page.run()
        finally:
            page.close()
    return 0


def write_replay(recording_file: Path, html: Path, *, force: bool) -> None:
    """Write a recorded run as one HTML file; a file of an earlier one is replaced.

    Raises:
        InputError: the recording cannot be read, `html` is a foreign file and `force` is False, or the extra
            `play` is not installed.
        OutputError: writing failed.
    """
    from skyherd.files.atomic import write_text
    from skyherd.files.output_file import OutputFile
    from skyherd.play.extras import require_viser

    require_viser("view")
    output = OutputFile(html, "view", force=force, inputs=[recording_file], parameter="html")
    output.check()
    recording = _read(recording_file)
    from skyherd.play.replay import replay_html

    with output, telling_of_interrupts(f"{output.path} is not written"):
        write_text(output.path, replay_html(recording.mission, recording.steps))


def _read(path: Path) -> "Recording":
    """Read a recording, and warn of its defects."""
    from skyherd.recording.reader import read_recording

    recording = read_recording(path)
    if not recording.whole:
        warn(f"{path}: {recording.flaws[0]}; the readable part is shown")
    return recording
