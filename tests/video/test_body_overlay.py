"""Bodies in pictures: position, size, overlaps and exchanged roles."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from skyherd.analysis.history import make_history
from skyherd.datasets import Mission, make_mission
from skyherd.drawing.palette import TEMPLATE_COLOR, WARNING, rgb
from skyherd.loop import Step, run_steps
from skyherd.plots.maps import draw_paths
from skyherd.video.body_overlay import BodySizes, overlapping_ids
from skyherd.video.camera_panel import CameraPanel
from skyherd.video.composer import Composer
from skyherd.video.ground_panel import EXCHANGE_S, GroundPanel
from skyherd.video.layout import make_layout
from skyherd.video.legend import BODY_ITEMS, ITEMS, TREE_ITEMS, legend_height_px

OBSTACLE = {"id": 40, "position_m": [0.4, 0.2], "radius_sides": 1.5}


@pytest.fixture(scope="module")
def run(scenario_tree) -> tuple[Mission, list[Step]]:
    """Run the triangle with bodies and an obstacle for a second."""
    tree = scenario_tree("triangle") | {"perception": "ideal", "duration_s": 1.0, "obstacles": [OBSTACLE]}
    tree["robots"]["body_radius_sides"] = 1.0
    tree["avoidance"] = {"margin_sides": 0.6, "on": True}
    tree["roles"] = {"exchange": False}
    mission = make_mission(tree)
    return mission, list(run_steps(mission))


def pixels_of(picture: np.ndarray, color: str, tolerance: int = 12) -> np.ndarray:
    """Return the positions (M, 2), (u, v), of a colour."""
    rows, columns = (np.abs(picture.astype(int) - rgb(color)).max(axis=2) <= tolerance).nonzero()
    return np.column_stack([columns, rows])


def side_by_side(mission: Mission, step: Step, first: int, second: int) -> Step:
    """Return the step with one robot half a body radius beside another."""
    positions = step.positions_m.copy()
    positions[first] = positions[second] + [0.5 * mission.bodies.radius_m, 0]
    return replace(step, positions_m=positions)


def test_sizes_match_mission(run) -> None:
    mission, steps = run
    sizes = BodySizes.of(mission)
    assert (sizes.radius, sizes.safety, sizes.obstacles) == (1.0, 1.3, {40: 1.5})
    assert overlapping_ids(mission, steps[0].positions_m) == frozenset()
    assert overlapping_ids(mission, side_by_side(mission, steps[0], 1, 4).positions_m) == {1, 4}
    on_it = steps[0].positions_m.copy()
    on_it[2] = OBSTACLE["position_m"]
    assert overlapping_ids(mission, on_it) == {2, 40}


def test_only_overlaps_have_warning(run) -> None:
    """In the ground view around both, within their radius and the rim's width; nowhere without."""
    mission, steps = run
    panel = np.full((640, 640, 3), 255, np.uint8)
    view = GroundPanel(mission, panel)
    view.draw(steps[0])
    assert not pixels_of(panel, WARNING).size
    hit = side_by_side(mission, steps[1], 1, 4)
    view.draw(hit, struck=overlapping_ids(mission, hit.positions_m))
    places, warned = view.to_panel(hit.positions_m[[1, 4]]), pixels_of(view._field, WARNING)
    radius_px = mission.bodies.radius_m * view._px_per_m
    distances = np.linalg.norm(warned[:, None] - places, axis=2).min(axis=1)
    assert len(warned) > 100
    assert distances.max() < radius_px + 6


def test_obstacle_has_true_size_on_ground(run) -> None:
    """Its dark rim lies at the radius, to the two pixels of its width."""
    mission, steps = run
    panel = np.full((640, 640, 3), 255, np.uint8)
    view = GroundPanel(mission, panel)
    view.draw(steps[0])
    (center,) = view.to_panel(mission.obstacle_positions_m)
    radius_px = mission.obstacle_radii_m[0] * view._px_per_m
    rays = np.exp(2j * np.pi * np.arange(72) / 72)
    ring = np.rint(center + radius_px * np.column_stack([rays.real, rays.imag])).astype(int)
    inside = ((ring >= 0) & (ring < np.array(view._field.shape[1::-1]))).all(axis=1)
    darkness = view._field[ring[inside, 1], ring[inside, 0]].mean(axis=1)
    assert inside.sum() > 40
    assert np.median(darkness) < 110


def test_camera_warns_without_counting_obstacles(run) -> None:
    mission, steps = run
    frame, titles = steps[0].frames[0], []
    cell = np.full((640, 640, 3), 255, np.uint8)
    view = CameraPanel(0, cell, (800, 800), mission.scenario.selection.radius, BodySizes.of(mission))
    view._write_title = lambda *texts: titles.append(texts[0])  # type: ignore[method-assign]
    view.draw(frame, steps[0].control_sets)
    assert 40 in frame.sight.detections.ids
    assert titles == ["unit 0 · 6 controlled · 6 seen"]
    assert not pixels_of(cell, WARNING).size
    view.draw(frame, steps[0].control_sets, frozenset({3}))
    (center,) = view.to_panel(frame.sight.detections.select([3]).centers_px)
    warned = pixels_of(cell, WARNING) - (3, 29)
    assert len(warned) > 50
    side_px = frame.sight.detections.select([3]).sides_px[0] * view.scale
    np.testing.assert_allclose(warned.mean(axis=0), center, atol=3.0)
    assert np.linalg.norm(warned - center, axis=1).max() < max(side_px, 7) + 12


def test_exchanged_role_is_shown_for_a_while(run) -> None:
    """Two robots exchange roles: their points are filled in the shape's colour for the stated time."""
    mission, steps = run
    panel = np.full((640, 640, 3), 255, np.uint8)
    view = GroundPanel(mission, panel)

    def colored(time_s: float, roles: list[int]) -> int:
        view.draw(replace(steps[0], time_s=time_s, roles=np.array(roles)))
        return len(pixels_of(panel, TEMPLATE_COLOR))

    colored(0.0, [0, 1, 2, 3, 4, 5])
    exchanged = [1, 0, 2, 3, 4, 5]
    at_once, late = colored(1.0, exchanged), colored(1.0 + EXCHANGE_S, exchanged)
    assert colored(5.0, exchanged) == late, "once over, it is over"
    assert at_once > late + 2 * 60, "two discs of more than 60 pixels"


def test_header_shows_least_gap(run) -> None:
    mission, steps = run
    composer = Composer(mission)
    assert not pixels_of(composer.compose(steps[0])[80:650, 700:], WARNING).size
    label, value, _ = composer._nearest(side_by_side(mission, steps[1], 1, 4))
    assert label == "least gap"
    assert value == f"−{1.5 * mission.bodies.radius_m:.2f} m"


@pytest.mark.parametrize("tree", [False, True])
@pytest.mark.parametrize("units", range(1, 17))
def test_longer_legend_fits(units: int, tree: bool) -> None:
    items = ITEMS + (TREE_ITEMS if tree else ()) + BODY_ITEMS
    layout = make_layout((1600, 1000), [(800, 800)] * units, items)
    assert legend_height_px(layout.key.width, items) <= layout.key.height
    covered = np.zeros((1000, 1600), dtype=int)
    for box in [*layout.cameras, layout.key, layout.ground, *layout.plots]:
        box.of(covered)[:] += 1
    assert covered.max() == 1
    assert min(box.width for box in layout.cameras) >= 64


def test_figure_has_obstacle_and_bodies(run) -> None:
    mission, steps = run
    figure = draw_paths(make_history(mission, steps))
    axes = figure.axes[0]
    circles: Any = [patch for patch in axes.patches if hasattr(patch, "radius")]
    side_m = mission.scenario.marker.side_m
    assert sorted(circle.radius for circle in circles) == pytest.approx([side_m] * 6 + [1.5 * side_m])
    assert "obstacle" in [text.get_text() for text in figure.legends[0].get_texts()]
