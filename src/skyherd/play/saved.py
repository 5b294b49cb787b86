"""A session as a scenario file, which `skyherd run` repeats."""

from collections.abc import Sequence
from copy import deepcopy
from pathlib import Path

from skyherd.datasets import Intervention, ScenarioSource, toml_text

TITLE = "# Saved by `skyherd play`. `skyherd run FILE` repeats the session.\n"
"""First line of a saved scenario."""


def saved_text(source: ScenarioSource, *, seed: int, duration_s: float, added: Sequence[Intervention]) -> str:
    """Return the TOML text of a scenario with further interventions.

    Args:
        source: the scenario as read. Relative paths of its pictures become absolute ones.
        seed: seed of the session.
        duration_s: duration of the saved scenario.
        added: interventions of the operator, in the order of time.
    """
    tree = deepcopy(source.tree)
    tree |= {"seed": seed, "duration_s": duration_s}
    interventions = [one.model_dump(mode="json", exclude_none=True) for one in added]
    tree["interventions"] = [*tree.get("interventions", []), *interventions]
    template = tree["template"]
    for table in (template, *template.get("then", []), tree.get("ground", {}), *tree["interventions"]):
        if "image" in table:
            table["image"] = str((source.folder / Path(table["image"])).resolve())
    if not tree["interventions"]:
        del tree["interventions"]
    return TITLE + toml_text(tree)
