"""Laws from the literature: what their papers prove of them, and robots that follow them."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from skyherd.datasets import load_mission, make_mission
from skyherd.errors import InputError
from skyherd.loop import run_steps
from skyherd.sim.baseline_laws import bearing_only_law, complex_laplacian, complex_laplacian_law, neighbors
from skyherd.sim.truth_metrics import fit_shape

GAIN = 0.5


def cloud(rng: np.random.Generator, count: int) -> np.ndarray:
    return rng.standard_normal(count) + 1j * rng.standard_normal(count)


def flow(law, places: np.ndarray, time_s: float, step_s: float = 0.02) -> np.ndarray:
    for _ in range(round(time_s / step_s)):
        places = places + step_s * law(places)
    return places


@pytest.mark.parametrize("count", [3, 4, 9, 30])
def test_the_complex_laplacian_is_stable_and_keeps_similar_shapes_alone(count) -> None:
    """Lin et al., Theorem 3.1: Lz = 0 for z = a 1 + b shape; rank N - 2, so for no other."""
    rng = np.random.default_rng(count)
    shape = cloud(rng, count)
    matrix = complex_laplacian(shape)
    np.testing.assert_allclose(matrix, matrix.conj().T, atol=1e-14)
    values = np.linalg.eigvalsh(matrix)
    assert np.abs(values[:2]).max() < 1e-12 * values[-1] * count
    assert count == 2 or values[2] > 1e-6 * values[-1]
    a, b = cloud(rng, 2)
    assert np.abs(matrix @ (a + b * shape)).max() < 1e-12 * np.abs(b * shape).max() * count


def test_a_robot_needs_its_neighbours_alone() -> None:
    shape = cloud(np.random.default_rng(2), 20)
    matrix = complex_laplacian(shape)
    joined = np.eye(20, dtype=bool)
    joined[tuple(neighbors(shape).T)] = joined[tuple(neighbors(shape).T[::-1])] = True
    assert (matrix[~joined] == 0).all() and not joined.all()


def test_robots_turned_and_scaled_move_alike_under_the_complex_laplacian() -> None:
    """In its own frame each robot needs no common one."""
    rng = np.random.default_rng(3)
    shape, places = cloud(rng, 12), cloud(rng, 12)
    law = complex_laplacian_law(shape, GAIN)
    a, b = cloud(rng, 2)
    np.testing.assert_allclose(law(a + b * places), b * law(places), atol=1e-13)


@pytest.mark.parametrize("make", [complex_laplacian_law, bearing_only_law])
def test_a_law_s_fastest_mode_at_the_shape_dies_out_at_rate_k(make) -> None:
    """By the difference quotient of the law: an error of the size of the step, 1e-6, in the eigenvalue."""
    rng = np.random.default_rng(4)
    shape = cloud(rng, 9)
    law, count, step = make(shape, GAIN), shape.size, 1e-6
    jacobian = np.empty((2 * count, 2 * count))
    for column in range(2 * count):
        moved = shape.copy()
        moved[column % count] += step * (1 if column < count else 1j)
        change = (law(moved) - law(shape)) / step
        jacobian[:, column] = np.concatenate([change.real, change.imag])
    values = np.linalg.eigvals(jacobian).real
    assert values.min() == pytest.approx(-GAIN, abs=1e-4)
    assert values.max() < 1e-4


def test_bearings_alone_keep_centroid_and_size_and_give_turn() -> None:
    """Zhao and Zelazo, Theorem 9: almost any start ends in the shape, as large as it was."""
    rng = np.random.default_rng(5)
    shape, start = cloud(rng, 10), 3.0 * cloud(rng, 10)
    end = flow(bearing_only_law(shape, GAIN), start, 600.0, step_s=0.05)
    found = fit_shape(shape, end)
    assert found.error < 1e-3
    assert found.rotation_rad == pytest.approx(0.0, abs=1e-3)
    assert abs(end.mean() - start.mean()) < 1e-9
    # steps of Euler's rule are tangents of the sphere that the flow stays on: they leave it by O(step)
    assert np.std(end) == pytest.approx(np.std(start), rel=1e-2)


def test_bearings_do_not_tell_distances() -> None:
    rng = np.random.default_rng(6)
    shape, places = cloud(rng, 8), cloud(rng, 8)
    law = bearing_only_law(shape, GAIN)
    np.testing.assert_allclose(law(7.0 * places) / 7.0, law(places), atol=1e-13)
    turned = complex(*Rotation.from_rotvec([0, 0, 1.0]).as_matrix()[:2, 0]) * places
    assert np.abs(np.abs(law(turned)) - np.abs(law(places))).max() > 0.01, "a common compass is needed"


def test_a_shape_in_a_line_has_no_triangles() -> None:
    with pytest.raises(InputError, match="line"):
        complex_laplacian_law(np.arange(5.0) + 0j, GAIN)


@pytest.mark.parametrize("method", ["complex-laplacian", "bearing-only"])
def test_robots_that_are_told_the_truth_form_the_shape_with_no_word_from_units(method) -> None:
    """Beside the control: with the units' law and every message lost nobody moves."""
    lost = [
        "perception=ideal",
        "roles.exchange=false",
        "avoidance.on=false",
        "size.least_spacing_sides=0",
        "robots.body_radius_sides=0",
        "robots.scatter.scale_m=2.6",
        "robots.scatter.jitter_m=0.5",
        "network.message_loss=0.99999",
        "step_s=0.2",
        "units.*.frame_rate_hz=1",
    ]
    errors = []
    for law, seconds in ((method, 120), ("similarity", 10)):  # robots that stand still do so at once
        settings = [*lost, f"control.method={law}", f"duration_s={seconds}"]
        *_, last = run_steps(load_mission("crowd", settings))
        errors.append(last.metrics.shape.error)
    assert errors[0] < 0.01 < 0.1 < errors[1]


@pytest.mark.parametrize(
    ("key", "given"),
    [
        ("roles", {"exchange": True}),
        ("avoidance", {"on": True}),
        ("control", {"gains": "pixel", "method": "bearing-only"}),
    ],
)
def test_what_a_law_from_the_literature_does_not_know_is_refused(scenario_tree, key, given) -> None:
    tree = scenario_tree("triangle")
    tree["control"] = {"method": "bearing-only"}
    with pytest.raises(InputError, match=r"control\.method bearing-only knows no"):
        make_mission(tree | {key: given})
