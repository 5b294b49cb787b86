"""Sentences on runs that do not reach their shape."""

import pytest

from skyherd.analysis.history import make_history
from skyherd.analysis.verdict import explain_failure
from skyherd.datasets import load_mission
from skyherd.loop import run_steps

FAR = ["units.0.position_m=[500, 500]", "units.0.flight={kind='hover'}"]


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        (["duration_s=6"], "s more are needed"),
        (["duration_s=2", *FAR], "no robot was ever in view"),
        (["duration_s=2", "units.0.height_m=3", "units.0.flight={kind='hover'}"], "fewer than two robots"),
    ],
)
def test_verdict_names_cause(settings: list[str], words: str) -> None:
    mission = load_mission("triangle", ["perception=ideal", *settings])
    assert words in explain_failure(make_history(mission, list(run_steps(mission))))
