"""Sentences on runs that do not reach their shape."""

from types import SimpleNamespace

import numpy as np
import pytest

from skyherd.analysis.history import make_history
from skyherd.analysis.verdict import _falling, explain_failure
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


@pytest.mark.parametrize(("rate_ps", "seconds"), [(0.1, 31), (0.2, 12)])
def test_time_needed_follows_an_exponential_decay(rate_ps, seconds) -> None:
    """`log(0.5 exp(-10 r) / 0.01) / r` and the 2 s for which the shape must be held: 31 s and 12 s."""
    times_s = np.linspace(0, 10, 101)
    scenario = SimpleNamespace(goal=SimpleNamespace(shape_error=0.01, hold_s=2.0))
    history = SimpleNamespace(
        times_s=times_s,
        shape_error=0.5 * np.exp(-rate_ps * times_s),
        mission=SimpleNamespace(scenario=scenario),
    )
    assert _falling(history) == (
        f"the error still falls by {100 * rate_ps:.1f} % a second; about {seconds} s more are needed"
    )
