"""Three cheap, swaying cameras: the scenario with and without rectification, and its video."""

from dataclasses import replace

import numpy as np
import pytest

from skyherd.datasets import load_mission
from skyherd.loop import Step, run_steps
from skyherd.sim.physics import make_world
from skyherd.video.camera_panel import BORDER_PX, TITLE_PX, brightened
from skyherd.video.composer import Composer
from skyherd.video.layout import make_layout
from skyherd.video.rectified_panel import RectifiedPanel

QUICK = ["perception=noisy", "duration_s=16.0", "control.k=0.6", "control.k_omega=2.4"]
"""Ten time constants, with the detector's noise."""


@pytest.fixture(scope="module", params=[True, False], ids=["rectified", "as seen"])
def flight(request: pytest.FixtureRequest) -> tuple[bool, list[Step]]:
    rectify = str(request.param).lower()
    return request.param, list(run_steps(load_mission("handheld", [*QUICK, f"control.rectify={rectify}"])))


def test_handheld_star_forms_only_with_rectification(flight):
    """0.1 % against some per cent: the negative control is the same flight without rectification."""
    rectified, steps = flight
    error = max(step.metrics.shape.error for step in steps[-20:])
    assert error < 1e-3 if rectified else error > 0.02
    assert all(step.metrics.conditions.tc2 for step in steps), "every robot is controlled"


def test_handheld_cameras_violate_property_1():
    mission = load_mission("handheld")
    assert not any(unit.ideal for unit in mission.scenario.units)
    assert all(unit.sway is not None for unit in mission.scenario.units)
    assert len({unit.camera.preset for unit in mission.scenario.units}) == 3
    assert all(unit.ideal for unit in load_mission("star").scenario.units)
    moving = make_world(mission).motion(0)
    assert any(moving.tilt_rates_radps)


def test_video_has_raw_and_rectified_panels():
    sizes = [(800, 600)] * 3
    both, plain = make_layout((1600, 1000), sizes, rectified=True), make_layout((1600, 1000), sizes)
    assert (len(both.cameras), len(both.rectified), len(plain.rectified)) == (3, 3, 0)
    for above, below in zip(both.cameras, both.rectified, strict=True):
        assert above.left == below.left
        assert above.top + above.height <= below.top
    boxes = [*both.cameras, *both.rectified, both.key, both.ground, *both.plots]
    for number, one in enumerate(boxes):
        for other in boxes[:number]:
            apart = (
                one.left >= other.left + other.width
                or other.left >= one.left + one.width
                or one.top >= other.top + other.height
                or other.top >= one.top + one.height
            )
            assert apart, "cells do not overlap"


@pytest.mark.parametrize("flight", [True], indirect=True)
def test_rectified_panel_is_image_under_estimated_map(flight):
    """A ramp along u replaces the image: each pixel of the panel shows the ramp at its mapped position.

    The tolerance is two grey levels: rounding, and a map that is linear over 8 px.
    """
    frame = flight[1][-1].frames[2]
    assert not frame.decision.ground_map.ideal
    width, height = 800, 600
    ramp = np.tile(np.linspace(20, 235, width).astype(np.uint8), (height, 1))
    shown = replace(frame, sight=replace(frame.sight, image=ramp))
    none = shown.decision.goals
    assert none is not None
    cell = np.zeros((TITLE_PX + 2 * BORDER_PX + 300, 2 * BORDER_PX + 400, 3), np.uint8)
    view = RectifiedPanel(2, cell, (width, height))
    view.draw(shown)
    panel = cell[TITLE_PX + BORDER_PX :, BORDER_PX:]
    v, u = np.mgrid[10:290:20, 10:390:20]
    places = np.column_stack([u.ravel(), v.ravel()])
    raw = frame.decision.ground_map.image_px((places + 0.5) / view.scale - 0.5, np.array([width, height]))
    inside = ((raw > 2) & (raw < [width - 3, height - 3])).all(axis=1)
    expected = brightened(ramp)[0, np.rint(raw[inside, 0]).astype(int)].astype(float)
    found = panel[places[inside, 1], places[inside, 0]].astype(float)
    plain = np.ptp(found, axis=1) == 0  # no mark over it
    assert plain.sum() > 50
    np.testing.assert_allclose(found[plain, 0], expected[plain], atol=2)


@pytest.mark.parametrize("flight", [True], indirect=True)
def test_video_has_rectified_panels_for_real_cameras(flight):
    names = {name: Composer(load_mission(name)) for name in ("handheld", "star")}
    assert (len(names["handheld"]._rectified), len(names["star"]._rectified)) == (3, 0)
    picture = names["handheld"].compose(flight[1][-1])
    assert picture.shape == (1000, 1600, 3)
    off = Composer(load_mission("handheld", ["control.rectify=false"]))
    assert not off._rectified
