"""`skyherd scenario`: list, show and check scenarios, and print their schema."""

import json
from typing import Annotated

import typer

from skyherd.cli.choices import complete_scenario
from skyherd.cli.console import say, say_table, warn
from skyherd.cli.options import Scenario, ScenarioSettings

scenario_app = typer.Typer(help="List, show and check scenarios.", rich_markup_mode=None)


@scenario_app.command("list")
def list_scenarios() -> None:
    """List the built-in scenarios."""
    from skyherd.datasets import load_mission, scenario_names

    rows = []
    for name in scenario_names():
        mission = load_mission(name)
        scenario = mission.scenario
        simulated = f"{scenario.duration_s:g} s"
        robots, units = str(mission.ids.size), str(len(scenario.units))
        rows.append((name, robots, units, simulated, scenario.description))
    say_table(("name", "robots", "units", "simulated", "what it shows"), rows)


@scenario_app.command()
def show(
    name: Annotated[
        str,
        typer.Argument(
            metavar="NAME", help="A built-in scenario, such as star.", autocompletion=complete_scenario
        ),
    ],
) -> None:
    """Print a built-in scenario, to save and change."""
    from skyherd.datasets import scenario_text

    typer.echo(scenario_text(name), nl=False)


@scenario_app.command()
def check(
    file: Scenario,
    settings: ScenarioSettings = None,
) -> None:
    """Check a scenario, and warn of what keeps its robots from the shape."""
    from skyherd.analysis.foresight import foresee
    from skyherd.datasets import load_mission

    mission = load_mission(file, settings or [])
    scenario = mission.scenario
    warnings = foresee(mission)
    word = "valid, with a warning" if warnings else "good"
    units = f"{len(scenario.units)} unit{'s' * (len(scenario.units) > 1)}"
    say(f"{file}: {word}: {mission.ids.size} robots, {units}, {scenario.duration_s:g} s")
    for warning in warnings:
        warn(warning)


@scenario_app.command()
def schema() -> None:
    """Print the JSON schema of scenario files."""
    from skyherd.datasets import Scenario

    typer.echo(json.dumps(Scenario.model_json_schema(), indent=2))
