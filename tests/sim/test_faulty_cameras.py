"""Cameras that freeze, lag or replay old images, as a scenario asks for."""

import pytest

from skyherd.datasets import load_mission
from skyherd.errors import InputError
from skyherd.loop import run_steps
from skyherd.recording.reader import read_steps
from skyherd.recording.writer import McapRecorder

pytestmark = pytest.mark.smoke

IDEAL = ["perception=ideal", "duration_s=6", "control.camera_check=false"]

QUICK = ["perception=noisy", "control.k=0.4", "control.k_omega=1.6", "duration_s=30"]


def places(settings):
    """Return the places of the first robot in unit 0's image, by time."""
    steps = run_steps(load_mission("triangle", [*IDEAL, *settings]))
    seen = {round(step.time_s, 3): step.frames[0].sight.detections for step in steps}
    assert all(detections.time_s == pytest.approx(time_s) for time_s, detections in seen.items())
    return {time_s: detections.centers_px[0].tolist() for time_s, detections in seen.items()}


@pytest.mark.parametrize(
    ("fault", "shown"),
    [
        ('kind = "freeze", start_s = 2.0, end_s = 4.0', {2.0: 2.0, 3.0: 2.0, 3.9: 2.0}),
        ('kind = "delay", by_s = 0.5, start_s = 2.0, end_s = 4.0', {2.0: 1.5, 3.0: 2.5, 3.9: 3.4}),
        ('kind = "delay", by_s = 5.0, start_s = 2.0, end_s = 4.0', {2.0: 0.0, 3.9: 0.0}),
        ('kind = "replay", by_s = 1.0, start_s = 2.0, end_s = 4.0', {2.0: 1.0, 2.9: 1.9, 3.1: 1.1}),
    ],
)
def test_shows_earlier_images_with_present_times(fault, shown) -> None:
    found = places([f"units.0.camera.faults=[{{ {fault} }}]"])
    truth = places(["units.0.camera.faults=[]"])
    early = [time_s for time_s in truth if time_s <= 1.9]
    assert [found[time_s] for time_s in early] == [truth[time_s] for time_s in early]
    assert len({tuple(truth[time_s]) for time_s in shown}) > 1
    # Until the fault both runs are equal, so that the images shown from before it are the other run's.
    before = {now_s: then_s for now_s, then_s in shown.items() if then_s <= 2.0}
    for now_s, then_s in before.items():
        assert found[now_s] == truth[then_s]
    for now_s, then_s in shown.items():
        if then_s > 2.0:
            assert found[now_s] != found[round(now_s - 0.1, 3)]


def test_fault_that_ends_before_its_start_is_refused() -> None:
    fault = 'units.0.camera.faults=[{ kind = "freeze", start_s = 3.0, end_s = 2.0 }]'
    with pytest.raises(InputError, match="end_s: 2, with start_s 3; more than start_s"):
        load_mission("triangle", [fault])


def test_unit_with_frozen_camera_sends_nothing_and_recovers(tmp_path) -> None:
    """Robots stop once their goals are stale, and form the shape after the fault. The recording keeps it."""
    fault = 'units.0.camera.faults=[{ kind = "freeze", start_s = 1.0, end_s = 6.0 }]'
    mission = load_mission("triangle", [*QUICK, fault])
    with McapRecorder(tmp_path / "run.mcap", mission) as recorder:
        steps = [step for step in run_steps(mission) if recorder.write(step) is None]
        recorder.finish(steps[-1].time_s, 1.0)
    quiet = [step for step in steps if step.frames[0].decision.suspicion]
    assert 1.0 < quiet[0].time_s <= 2.1
    assert 6.9 <= quiet[-1].time_s <= 8.0
    stopped = [step for step in steps if quiet[0].time_s + 0.7 < step.time_s < quiet[-1].time_s]
    assert all(not step.commanded_ids.size and not step.control_sets[0].size for step in stopped)
    assert steps[-1].metrics.shape.error < 0.01
    read = [step.time_s for step in read_steps(tmp_path / "run.mcap") if step.frames[0].decision.suspicion]
    assert read == pytest.approx([step.time_s for step in quiet])
