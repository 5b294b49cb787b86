"""Parallel processing of cameras has the same results, byte for byte, as sequential processing."""

import os
import signal

import numpy as np
import pytest

from skyherd.datasets import load_mission
from skyherd.errors import OutputError
from skyherd.jobs.helpers import can_help
from skyherd.loop import run_steps
from skyherd.runner import run_mission
from skyherd.sim.perception import RenderedPerception, make_run_perception
from skyherd.sim.side_by_side import DRAWING, READING, SideBySide, deal
from skyherd.vision import create_detector

pytestmark = pytest.mark.skipif(not can_help(), reason="processes are forked on Linux only")

SMALL = ["units.*.camera.size_px=[320, 240]", "duration_s=0.8"]
"""Settings of a short run with small images."""

INTERVENTIONS = """
{at_s = 0.2, kind = "camera", unit = 1, noise = 6.0, psf_px = 1.3, exposure_s = 0.02},
{at_s = 0.3, kind = "camera", unit = 2, noise = 0.0, frame_loss = 0.5},
{at_s = 0.4, kind = "cover", marker = 3},
{at_s = 0.5, kind = "kill", unit = 0}
""".replace("\n", " ")
"""Changes that reach the helpers of the cameras."""


def everything(mission, jobs):
    """Return the bytes of all images and detections of a run, and of the positions of robots and units."""
    said = []
    with SideBySide(make_run_perception(mission), jobs) as perception:
        for step in run_steps(mission, perception):
            said += [step.positions_m.tobytes(), step.fleet.positions_m.tobytes()]
            for unit, frame in step.frames.items():
                sight = frame.sight
                found = sight.detections
                said += [unit, sight.image.tobytes(), found.centers_px.tobytes(), found.covariances.tobytes()]
                said += [sight.whole_ids.tobytes(), sight.found_ids.tobytes(), sight.false_detections]
    return said


@pytest.mark.parametrize(
    "settings",
    [
        [],
        ["units.1.frame_rate_hz=4", "network.frame_loss=0.3", "sensor.shot=0.4", "sensor.jpeg_quality=80"],
        ["units.0.outages=[[0.0, 0.3]]", "sensor.noise=0"],
        [f"interventions=[{INTERVENTIONS}]"],
    ],
    ids=["usual", "frames lost and another sensor", "a unit that begins late", "cameras that change"],
)
def test_results_are_the_same_for_any_number_of_jobs(settings):
    """Lost frames and units that start late change the order of images in the sequence of noise."""
    mission = load_mission("star", [*SMALL, *settings])
    alone = everything(mission, 1)
    assert len(alone) > 50
    for jobs in (2, 4):
        assert everything(mission, jobs) == alone


def test_without_skipping_the_images_of_others_noise_is_another(monkeypatch):
    """Negative control: the test above is sensitive to the order of random numbers."""
    mission = load_mission("star", SMALL)
    alone = everything(mission, 1)
    monkeypatch.setattr(RenderedPerception, "skip", lambda self, view: None)
    assert everything(mission, 2) != alone


def test_of_three_cameras_two_helpers_draw_one_for_each_other():
    """The tests above therefore cover images that one helper renders and another reads."""
    crossed = [share.reads - share.draws for share in deal(3, 2)]
    assert sorted(map(len, crossed)) == [0, 1]


@pytest.mark.parametrize(
    ("units", "helpers"), [(u, h) for u in range(1, 18) for h in range(1, min(u, 6) + 1)]
)
def test_cameras_are_dealt_once_with_balanced_work(units, helpers):
    shares = deal(units, helpers)
    assert len(shares) == helpers
    for done in ("draws", "reads"):
        assert sorted(unit for share in shares for unit in getattr(share, done)) == list(range(units))
    work = [DRAWING * len(share.draws) + READING * len(share.reads) for share in shares]
    assert max(work) - min(work) <= READING


@pytest.mark.slow
def test_a_whole_run_leaves_the_same_files(tmp_path):
    mission = load_mission("star", ["duration_s=3"])
    for jobs in (1, 2):
        run_mission(mission, tmp_path / str(jobs), jobs=jobs)
    one, two = (
        {path.name: path.read_bytes() for path in (tmp_path / name).rglob("*.*") if path.is_file()}
        for name in "12"
    )
    assert one.keys() == two.keys()
    with_times = {"run.mcap", "summary.json", "report.html", ".skyherd.json"}
    assert {name for name in one if one[name] != two[name]} <= with_times
    assert "video.mp4" in one


def test_a_helper_that_is_killed_ends_the_run_in_one_line():
    mission = load_mission("star", SMALL)
    with SideBySide(make_run_perception(mission), 2) as perception:
        steps = run_steps(mission, perception)
        next(steps)
        next(steps)
        os.kill(perception._helpers[0]._process.pid, signal.SIGKILL)
        with pytest.raises(OutputError, match=r"has ended by itself; .* fewer `jobs=`"):
            for _ in steps:
                pass


def make_detector(dictionary):
    """Make a user-defined detector."""
    return create_detector("opencv", dictionary=dictionary)


@pytest.mark.parametrize(
    "settings",
    [["perception=ideal"], ["sensor.processing.h264_crf=23"], [f"detector={__name__}:make_detector"]],
    ids=["no images", "a video", "a detector of one's own"],
)
def test_what_cannot_be_forked_stays_in_its_process(settings):
    mission = load_mission("star", [*SMALL, "duration_s=0.2", *settings])
    with SideBySide(make_run_perception(mission), 4) as perception:
        assert len(list(run_steps(mission, perception))) == 3
        assert not perception._helpers


def test_a_single_camera_stays_in_its_process():
    mission = load_mission("triangle", ["duration_s=0.2"])
    assert len(mission.scenario.units) == 1
    with SideBySide(make_run_perception(mission), 4) as perception:
        assert len(list(run_steps(mission, perception))) == 3
        assert not perception._helpers


@pytest.mark.smoke
def test_images_are_ones_own():
    """The helpers reuse their shared memory for the next image."""
    mission = load_mission("star", SMALL)
    with SideBySide(make_run_perception(mission), 2) as perception:
        images = [step.frames[0].sight.image for step in run_steps(mission, perception)]
    assert all(not np.shares_memory(images[-1], image) for image in images[:-1])
    assert len({image.tobytes() for image in images}) == len(images)
