"""Views of a unit's images, against their mathematical definition."""

from dataclasses import replace

import numpy as np
import pytest
from live_sessions import small_lab

from skyherd.geometry import to_complex, to_points
from skyherd.live.logs.view import view_of
from skyherd.messages import Detections
from skyherd.messages.role_map import RoleMap


@pytest.fixture(scope="module")
def lab():
    return small_lab(robots=5)


def seen(points, ids):
    corners = np.array([-10 - 10j, 10 - 10j, 10 + 10j, -10 + 10j])
    return Detections(
        unit_id=0,
        time_s=100.0,
        image_size_px=np.array([640, 480]),
        ids=ids,
        centers_px=to_points(points),
        headings_rad=np.full(ids.size, -np.pi / 2),
        sides_px=np.full(ids.size, 20.0),
        corners_px=to_points((points[:, None] + corners).ravel()).reshape(-1, 4, 2),
        covariances=np.zeros((ids.size, 3, 3)),
    )


def decision_on(lab, points, ids=None):
    """Return the decision of the lab's unit on robots at image points, without rectification."""
    unit = lab.make_unit(0)
    unit._controller.rectifier = None
    return unit.see(seen(points, np.arange(len(points)) if ids is None else ids), 100.0).decision


def test_formed_shape_has_zero_error_and_goals_at_robots(lab) -> None:
    points = 320 + 240j + 40 * np.exp(0.7j) * lab.template.points_px
    view = view_of(decision_on(lab, points), lab.template)
    assert view.shape_error < 1e-12 and view.robots == 5 and view.captured_s == 100.0
    np.testing.assert_allclose(view.goals_px, to_points(points)[view.ids], atol=1e-9)


def test_error_and_goals_match_the_best_similarity(lab) -> None:
    rng = np.random.default_rng(4)
    points = 320 + 240j + 40 * lab.template.points_px + rng.normal(size=5) + 5j * rng.normal(size=5)
    view = view_of(decision_on(lab, points), lab.template)
    design = np.stack([lab.template.points_px, np.ones(5)], axis=1)
    fitted = design @ np.linalg.lstsq(design, points, rcond=None)[0]
    error = np.linalg.norm(fitted - points) / np.linalg.norm(points - points.mean())
    assert view.shape_error == pytest.approx(error, rel=1e-9)
    assert view.ids.size == 5
    np.testing.assert_allclose(to_complex(view.goals_px), fitted[view.ids], atol=1e-6)


def test_exchanged_roles_change_the_shape(lab) -> None:
    roles = np.array([1, 0, 2, 4, 3])
    points = 320 + 240j + 40 * lab.template.points_px[roles]
    decision = decision_on(lab, points)
    assert view_of(decision, lab.template).shape_error > 0.1
    exchanged = replace(decision, report=replace(decision.report, roles=RoleMap(1, 0, roles)))
    assert view_of(exchanged, lab.template).shape_error < 1e-12


def test_error_with_two_robots_is_nan(lab) -> None:
    points = 320 + 240j + 40 * lab.template.points_px[:4]
    view = view_of(decision_on(lab, points, np.array([0, 1, 30, 31])), lab.template)
    assert np.isnan(view.shape_error) and view.robots == 2
