"""Recording of a simulated world: a killed process loses at most half a second."""

import io
from types import SimpleNamespace

import pytest

from skyherd.datasets import load_mission
from skyherd.live.world.process import WorldProcess
from skyherd.messages import TIME_TOLERANCE_S
from skyherd.recording.mcap_log import FLUSH_S
from skyherd.recording.survey import survey

BEGIN_S = 1000.0
"""Time of the clock at the first step, s."""


def make_world(path, speed: float) -> tuple[WorldProcess, list[float]]:
    """Return a world without cameras and received messages, and the time of its clock as a list of one."""
    now_s = [BEGIN_S]
    mission = load_mission("triangle", ["perception=ideal", "duration_s=60"])
    silent = SimpleNamespace(fetch=lambda: [])
    return WorldProcess(mission, speed, lambda: now_s[0], silent, path), now_s


@pytest.mark.parametrize("speed", [0.1, 1.0, 3.0])
def test_killed_world_loses_at_most_half_a_second(tmp_path, speed) -> None:
    """The file after each step is read like the one after SIGKILL, which keeps all data written to it."""
    path = tmp_path / "world.mcap"
    world, now_s = make_world(path, speed)
    assert [chunk.after for chunk in survey(io.BytesIO(path.read_bytes())).chunks] == [1]
    chunks = 0
    for _ in range(40):
        world.step()
        found = survey(io.BytesIO(path.read_bytes())).chunks
        assert now_s[0] - found[-1].last_s <= FLUSH_S + TIME_TOLERANCE_S
        chunks, now_s[0] = len(found), now_s[0] + world.mission.scenario.step_s / speed
    # One chunk per step would compress badly.
    steps_a_chunk = max(1, int(FLUSH_S * speed / world.mission.scenario.step_s))
    assert chunks <= 3 + 40 / steps_a_chunk
    world.close()


def test_clock_that_goes_back_loses_nothing_more(tmp_path) -> None:
    path = tmp_path / "world.mcap"
    world, now_s = make_world(path, 1.0)
    world.step()
    now_s[0] -= 500.0
    world.step()
    assert survey(io.BytesIO(path.read_bytes())).chunks[-1].last_s == now_s[0]
    world.close()
