"""`skyherd scenario`: list, show and check scenarios, and print their schema."""

import json
from typing import Annotated

import typer
from rich.table import Table

from skyherd.cli.console import out
from skyherd.datasets import Scenario, load_mission, scenario_names, scenario_text

scenario_app = typer.Typer(help="List, show and check scenarios.", rich_markup_mode=None)


@scenario_app.command("list")
def list_scenarios() -> None:
    """List the built-in scenarios."""
    table = Table(box=None, header_style="bold")
    for column in ("name", "robots", "units", "simulated", "what it shows"):
        table.add_column(column)
    for name in scenario_names():
        mission = load_mission(name)
        scenario = mission.scenario
        table.add_row(
            name,
            str(mission.ids.size),
            str(len(scenario.units)),
            f"{scenario.duration_s:g} s",
            scenario.description,
        )
    out.print(table)


@scenario_app.command()
def show(name: Annotated[str, typer.Argument(help="A built-in scenario.")]) -> None:
    """Print a built-in scenario, to be saved and changed."""
    typer.echo(scenario_text(name), nl=False)


@scenario_app.command()
def check(
    file: Annotated[str, typer.Argument(help="A TOML file or a built-in scenario.")],
    settings: Annotated[list[str] | None, typer.Option("--set", help="key=value put over it.")] = None,
) -> None:
    """Check a scenario without running it."""
    mission = load_mission(file, settings or [])
    scenario = mission.scenario
    out.print(
        f"{file}: good: {mission.ids.size} robots, {len(scenario.units)} unit(s), {scenario.duration_s:g} s",
        markup=False,
    )


@scenario_app.command()
def schema() -> None:
    """Print the JSON schema of scenario files."""
    typer.echo(json.dumps(Scenario.model_json_schema(), indent=2))
