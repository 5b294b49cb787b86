"""`skyherd play`: a simulation on an interactive page, on which it can be disturbed while it runs."""

from pathlib import Path
from typing import Annotated

import typer

from skyherd.cli.console import say, warn
from skyherd.cli.interrupts import telling_of_interrupts
from skyherd.cli.options import (
    DEFAULT_PORT,
    LOOPBACK,
    PageHost,
    PagePort,
    Perception,
    Scenario,
    ScenarioSettings,
)


def play(
    scenario: Scenario = "star",
    seed: Annotated[
        int | None, typer.Option(metavar="N", help="Replace the scenario's seed of all random draws.")
    ] = None,
    settings: ScenarioSettings = None,
    perception: Perception = None,
    out_dir: Annotated[
        Path, typer.Option("--out", metavar="DIR", help="Save scenarios into this existing folder.")
    ] = Path("."),
    speed: Annotated[
        float, typer.Option(metavar="X", min=0.01, max=100, help="Simulated seconds in a second.")
    ] = 1.0,
    port: PagePort = DEFAULT_PORT,
    host: PageHost = LOOPBACK,
) -> int:
    """Show and disturb a running simulation in the browser.

    It prints the page's address. Ctrl-C ends it. Nothing is written unless you save.
    """
    from skyherd.play.extras import require_viser
    from skyherd.play.session import Session
    from skyherd.report.access import Access, bind

    require_viser("play")
    chosen = [*(settings or []), *([f"perception={perception}"] if perception else [])]
    session = Session.open(scenario, chosen, seed=seed, folder=out_dir, speed=speed)
    with bind(host, port) as listener:
        access = Access.make(host, listener.getsockname()[1])
        from skyherd.play.page import Page

        if host != LOOPBACK:
            warn(f"the page can be reached at {host}, without encryption; its address is a password")
        page = Page(session, access, listener)
        say(f"open {access.url}")
        try:
            with telling_of_interrupts("scenarios that were saved are kept"):
                page.run()
        finally:
            page.close()
    return 0
