"""Lens blur and processing as keys of scenario files: off by default, bounded, and used in two scenarios."""

import numpy as np
import pytest

from skyherd.datasets import load_mission
from skyherd.errors import InputError
from skyherd.loop import run_steps
from skyherd.sim.perception import make_renderer

CONSUMER = ("star", "handheld")


def test_everything_is_off_unless_a_scenario_says_otherwise():
    renderer = make_renderer(load_mission("star"), np.random.default_rng(0))
    assert renderer.lens_blur.none and renderer.sensor.linear
    assert renderer.sensor.processing.h264_crf is None


@pytest.mark.parametrize("name", CONSUMER)
def test_consumer_scenario_differs_only_in_its_cameras(name):
    plain, consumer = (load_mission(each).scenario for each in (name, f"{name}-consumer"))
    told = {"name", "description", "sensor"}
    assert consumer.model_dump(exclude=told) == plain.model_dump(exclude=told)
    processing = consumer.sensor.processing.make()
    assert processing.mosaic.on and processing.gamma > 1 and processing.denoise and processing.sharpen
    assert processing.h264_crf is not None and not consumer.sensor.lens_blur.make().none


@pytest.mark.parametrize(
    ("key", "off"),
    [
        ("lens_blur.disc_px", 0),
        ("processing.demosaic", "none"),
        ("processing.gamma", 1),
        ("processing.denoise", 0),
        ("processing.sharpen", 0),
    ],
)
def test_each_part_of_a_consumer_camera_is_off_by_one_key(key, off):
    """The renderer then has all other parts, and this one at its neutral value."""
    table, name = key.split(".")
    value = f'"{off}"' if isinstance(off, str) else off
    changed = load_mission("star-consumer", [f"sensor.{key}={value}"]).scenario.sensor
    default = load_mission("star").scenario.sensor
    assert getattr(getattr(changed, table), name) == getattr(getattr(default, table), name) == off
    whole = load_mission("star-consumer").scenario.sensor
    assert getattr(changed, table).model_dump(exclude={name}) == getattr(whole, table).model_dump(
        exclude={name}
    )


@pytest.mark.parametrize(
    "wrong",
    [
        "lens_blur.disc_px=-1",
        "lens_blur.coma_px=21",
        "lens_blur.aperture_m=11",
        "lens_blur.focus_m=0",
        'processing.demosaic="nearest"',
        "processing.red_gain=0.9",
        "processing.gamma=0",
        "processing.s_curve=1.5",
        "processing.denoise=256",
        "processing.sharpen=6",
        "processing.sharpen_px=0.1",
        "processing.h264_crf=52",
    ],
)
def test_what_no_camera_has_is_refused_in_one_line(wrong):
    with pytest.raises(InputError) as error:
        load_mission("star", [f"sensor.{wrong}"])
    assert "\n" not in str(error.value) and wrong.split("=")[0] in str(error.value)


@pytest.mark.slow
@pytest.mark.parametrize(("name", "duration_s"), [("star", 24.0), ("handheld", 16.0)])
def test_the_star_forms_through_consumer_cameras(name, duration_s):
    """Four times as fast as the scenario; the project requires a shape error below 0.2 %."""
    fast = ["control.k=0.6", "control.k_omega=2.4", f"duration_s={duration_s}"]
    steps = list(run_steps(load_mission(f"{name}-consumer", fast)))
    assert max(step.metrics.shape.error for step in steps[-10:]) < 2e-3
