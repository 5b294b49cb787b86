"""Text on the page: the state, and interventions in a few words, without markup of other sources."""

from typing import Any

from skyherd.datasets import Intervention, Mission
from skyherd.loop import Step


def state_line(step: Step, mission: Mission, state: str) -> str:
    """Return time, state and shape error of a step as one line of Markdown."""
    error = step.metrics.shape.error
    reached = " · **shape reached**" if error < mission.scenario.goal.shape_error else ""
    return f"**{step.time_s:.1f} s** · {state} · shape error **{100 * error:.2g} %**{reached}"


def describe(intervention: Intervention) -> str:
    """Return an intervention in a few words."""
    given = intervention.model_dump(mode="json", exclude_none=True)
    kind = given.pop("kind")
    del given["at_s"]
    target = next((f" {key} {given.pop(key)}" for key in ("unit", "robot", "marker") if key in given), "")
    names = ", ".join(f"{key} {shown(value)}" for key, value in given.items())
    return f"{kind}{target if kind not in target else target.removeprefix(f' {kind}')} {names}".strip()


def shown(value: Any) -> str:
    """Return a value as short text."""
    if isinstance(value, list):
        return f"({', '.join(map(shown, value))})" if len(value) < 4 else f"{len(value)} items"
    if isinstance(value, dict):
        return " ".join(f"{key} {shown(one)}" for key, one in value.items() if one)
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def escaped(text: str) -> str:
    """Return a text without characters that Markdown would read as markup."""
    return "".join(" " if character in "`*<>[]|\\#$!~\n" else character for character in text)
