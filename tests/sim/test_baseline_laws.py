"""Laws from the literature: properties proven in their papers, and robots that follow them."""

from functools import partial
from pathlib import Path

import numpy as np
import pytest
from scipy.linalg import expm
from scipy.spatial.transform import Rotation

from skyherd.datasets import METHODS, load_mission, make_mission, shape_points
from skyherd.errors import InputError
from skyherd.geometry import to_complex
from skyherd.loop import run_steps
from skyherd.sim.baseline_laws import LAWS
from skyherd.sim.baseline_laws.affine import module_rows, stress_matrix
from skyherd.sim.baseline_laws.bearings import bearing_only_law
from skyherd.sim.baseline_laws.distances import distance_law
from skyherd.sim.baseline_laws.graphs import modules, neighbors, triangles
from skyherd.sim.baseline_laws.laplacians import complex_laplacian, complex_maneuver_law, follower_links
from skyherd.sim.baseline_laws.mean_shift import mean_shift_law
from skyherd.sim.truth_metrics import affine_error, fit_shape

GAIN = 0.5
SIMILAR, AFFINE = ("complex-laplacian", "matrix-weighted"), ("affine-modules", "affine-stress")
BEARINGS = ("bearing-only", "bearings-with-ranges")
LINEAR = (*SIMILAR, *AFFINE, "bearings-with-ranges")
CORNERS = ("angles", "distance-ratios")
FREE = (
    dict.fromkeys((*SIMILAR, *CORNERS), 4)
    | dict.fromkeys(AFFINE, 6)
    | dict.fromkeys((*BEARINGS, "distances"), 3)
    | {"mean-shift": 2}
)
"""Dimensions of the equilibria of a law: similar shapes; affine shapes; translated and scaled ones;
translated and rotated ones; translated ones."""


def cloud(rng: np.random.Generator, count: int) -> np.ndarray:
    return rng.standard_normal(count) + 1j * rng.standard_normal(count)


def grid(columns: int, rows: int) -> np.ndarray:
    return (np.arange(columns) + 1j * np.arange(rows)[:, None]).ravel()


def real(points: np.ndarray) -> np.ndarray:
    return np.concatenate([points.real, points.imag])


def moved(points: np.ndarray, matrix: np.ndarray, by: complex = 0.3 - 2.0j) -> np.ndarray:
    """Map points by a real 2 x 2 matrix, and translate them."""
    x, y = matrix @ np.stack([points.real, points.imag])
    return x + 1j * y + by


def turned(angle_rad: float, factor: float = 1.0) -> np.ndarray:
    return factor * Rotation.from_rotvec([0, 0, angle_rad]).as_matrix()[:2, :2]


SHEAR = np.array([[1.0, 0.4], [0.0, 0.7]])
MIRROR = np.diag([1.0, -1.0])
MAPS = {
    "translated": turned(0.0),
    "larger": turned(0.0, 1.7),
    "turned": turned(1.1),
    "sheared": SHEAR,
    "mirrored": MIRROR,
}
ADMITTED = {
    **{method: {"translated", "larger", "turned"} for method in (*SIMILAR, "angles")},
    **{method: set(MAPS) for method in AFFINE},
    **{method: {"translated", "larger"} for method in BEARINGS},
    "distances": {"translated", "turned", "mirrored"},
    "distance-ratios": {"translated", "larger", "turned", "mirrored"},
    "mean-shift": {"translated"},
}
"""Maps from the shape to other equilibria of a law, which are also its symmetries."""


def jacobian(law, shape: np.ndarray, step: float = 1e-6) -> np.ndarray:
    """Return the Jacobian (2 N, 2 N) of a law at a shape, by central differences."""
    columns = []
    for column in range(2 * shape.size):
        off = np.zeros(shape.size, dtype=complex)
        off[column % shape.size] = step * (1 if column < shape.size else 1j)
        columns.append(real(law(shape + off) - law(shape - off)) / (2 * step))
    return np.array(columns).T


def flow(law, places: np.ndarray, time_s: float, step_s: float = 0.02) -> np.ndarray:
    for _ in range(round(time_s / step_s)):
        places = places + step_s * law(places)
    return places


def test_every_law_of_scenario_files_is_there() -> None:
    assert tuple(LAWS) == METHODS[1:] and set(LAWS) == set(FREE) == set(ADMITTED)


@pytest.mark.parametrize("name", MAPS)
@pytest.mark.parametrize("method", LAWS)
def test_law_stands_still_only_at_its_equilibria(method, name) -> None:
    """At a distance of about the shape's size, speeds have the magnitude of the rate times this distance."""
    shape = cloud(np.random.default_rng(1), 11)
    fastest = np.abs(LAWS[method].make(shape, GAIN)(moved(shape, MAPS[name]))).max()
    if name in ADMITTED[method]:
        assert fastest < 1e-12
    else:
        assert fastest > 0.01 * GAIN


@pytest.mark.parametrize("method", LAWS)
def test_fastest_mode_has_rate_k_and_only_free_modes_persist(method) -> None:
    """Linearisation at the shape; differences err by 1e-10, eigenvalues of a triangular matrix by more."""
    shape = cloud(np.random.default_rng(4), 9)
    values = np.sort(np.linalg.eigvals(jacobian(LAWS[method].make(shape, GAIN), shape)).real)
    assert np.abs(values[-FREE[method] :]).max() < 1e-6
    assert values[-FREE[method] - 1] < -1e-3 * GAIN
    if method != "matrix-weighted":
        assert values[0] == pytest.approx(-GAIN, abs=1e-6)


def rates_of(shape: np.ndarray, velocity: complex, rate: complex) -> np.ndarray:
    return velocity + rate * (shape - shape.mean())


def test_maneuver_moves_any_similar_shape_in_its_own_frame() -> None:
    rng = np.random.default_rng(7)
    shape, (factor, place, velocity, rate) = cloud(rng, 11), cloud(rng, 4)
    wanted = rates_of(shape, velocity, rate)
    law = complex_maneuver_law(shape, wanted)
    np.testing.assert_allclose(law(factor * shape + place), factor * wanted, atol=1e-12)


def test_maneuver_keeps_star_stable_and_moves_one_zero() -> None:
    """The zero eigenvalue of the shape becomes the rate g + iω, and that of its place stays."""
    shape = to_complex(shape_points("star", 16))
    for rate in (0.01, -0.01, 0.06j, -0.06j):
        move = complex_maneuver_law(shape, rates_of(shape, 0.07, rate))
        law = LAWS["complex-laplacian"].make(shape, 4.8)
        values = np.linalg.eigvals(np.array([law(unit) + move(unit) for unit in np.eye(16) + 0j]).T)
        for moving in (0.0, rate):
            nearest = np.argmin(np.abs(values - moving))
            assert abs(values[nearest] - moving) < 1e-9
            values = np.delete(values, nearest)
        assert values.real.max() < -0.05


def test_maneuver_uses_links_of_the_law_alone() -> None:
    shape = cloud(np.random.default_rng(8), 11)
    law = complex_maneuver_law(shape, rates_of(shape, 0.3, 0.1j))
    matrix = np.array([law(unit) for unit in np.eye(11) + 0j]).T
    linked = {tuple(link) for link in LAWS["complex-laplacian"].links(shape).tolist()}
    used = {tuple(link) for link in np.argwhere(np.abs(matrix) > 1e-12).tolist() if link[0] != link[1]}
    assert used <= linked


def test_moving_shape_follows_its_motion_from_its_time_on() -> None:
    """Without bodies and with wheels that move in any direction, the shape turns and grows as asked."""
    settings = [
        "control.method=complex-laplacian",
        "control.k=4.8",
        "perception=ideal",
        "units.*.frame_rate_hz=0.02",
        "roles.exchange=false",
        "size.min_spacing_sides=0",
        "avoidance.on=false",
        "robots.drive.axis_offset_m=0.1",
        "robots.scatter={ scale_m = 4.0, jitter_m = 0.1, rotation_deg = 20.0 }",
        "duration_s=30",
    ]
    motion = "{ at_s = 20.0, turn_degps = 2.0, growth_percent_ps = 1.0 }"
    mission = load_mission("crowd", [*settings, f"template.motion=[{motion}]"])
    steps = {round(step.time_s, 3): step.metrics.shape for step in run_steps(mission)}
    before, after = steps[19.9], steps[29.9]
    assert after.error < 0.01
    assert np.degrees(after.rotation_rad - before.rotation_rad) == pytest.approx(19.8, abs=0.5)
    assert np.log(after.scale / before.scale) == pytest.approx(0.099, abs=0.005)


def test_only_laws_that_move_a_shape_are_given_motions() -> None:
    for method, law in LAWS.items():
        settings = [
            f"control.method={method}",
            "roles.exchange=false",
            "size.unit_m=4.0",
            "template.motion=[{ at_s = 2.0, turn_degps = 2.0 }]",
        ]
        if law.move is not None:
            assert load_mission("crowd", settings).scenario.template.motion
            continue
        with pytest.raises(InputError, match=r"template.motion: not supported by control.method"):
            load_mission("crowd", settings)


def test_every_mode_of_followers_has_the_rate_k() -> None:
    """`A (A + k I)^d = 0` for some d proves without eigenvalues that they are all 0 or -k."""
    shape = cloud(np.random.default_rng(5), 9)
    law = LAWS["matrix-weighted"].make(shape, GAIN)
    matrix = np.array([law(unit) for unit in np.eye(9) + 0j]).T
    assert np.abs(matrix @ np.linalg.matrix_power(matrix + GAIN * np.eye(9), 7)).max() < 1e-12
    assert np.abs(matrix @ (matrix + GAIN * np.eye(9))).max() > 1e-3


@pytest.mark.parametrize("name", MAPS)
@pytest.mark.parametrize("method", LAWS)
def test_law_is_equivariant_under_maps_of_its_paper(method, name) -> None:
    """Bearings contain no lengths: speeds are proportional to the formation's size, which determines m."""
    rng = np.random.default_rng(6)
    shape, places = cloud(rng, 10), cloud(rng, 10)
    law, matrix = LAWS[method].make(shape, GAIN), MAPS[name]
    wanted = moved(law(places), matrix, by=0.0)
    difference = np.abs(law(moved(places, matrix)) - wanted).max()
    if name in ADMITTED[method]:
        assert difference < 1e-12
    else:
        assert difference > 1e-3


@pytest.mark.parametrize("method", LAWS)
def test_a_robot_needs_to_know_those_it_is_linked_to_alone(method) -> None:
    """The test removes the size, which bearing-only robots know from the start."""
    rng = np.random.default_rng(2)
    shape, places = cloud(rng, 20), cloud(rng, 20)
    law, links = LAWS[method].make(shape, GAIN), LAWS[method].links(shape)

    def velocities(at: np.ndarray) -> np.ndarray:
        return law(at) / np.std(at) ** {"bearing-only": 1, "angles": 2, "distance-ratios": 2}.get(method, 0)

    needed = np.eye(20, dtype=bool)
    needed[tuple(links.T)] = True
    felt = np.zeros((20, 20), dtype=bool)
    for other in range(20):
        off = places.copy()
        off[other] += 0.1 + 0.05j
        felt[:, other] = np.abs(velocities(off) - velocities(places)) > 1e-12
    assert not felt[~needed].any() and needed.all() == (method == "mean-shift")
    assert felt[tuple(links.T)].mean() > 0.9
    assert len(np.unique(links, axis=0)) == len(links) and (links[:, 0] != links[:, 1]).all()


@pytest.mark.parametrize("method", ["complex-laplacian", *AFFINE, "bearings-with-ranges"])
def test_symmetric_laws_converge_to_nearest_equilibrium(method) -> None:
    """The reference is a least-squares fit of the free directions, without the law's own matrix."""
    rng = np.random.default_rng(7)
    shape, start = cloud(rng, 8), cloud(rng, 8)
    law = LAWS[method].make(shape, GAIN)
    ones, x, y = np.ones(8) + 0j, shape.real, shape.imag
    free = {
        "complex-laplacian": [ones, 1j * ones, shape, 1j * shape],
        "bearings-with-ranges": [ones, 1j * ones, shape],
    }.get(method, [ones, 1j * ones, x + 0j, 1j * x, y + 0j, 1j * y])
    columns = np.stack([real(direction) for direction in free], axis=1)
    nearest = columns @ np.linalg.lstsq(columns, real(start))[0]
    end = expm(jacobian(law, np.zeros(8) + 0j, step=1.0) * 1e5) @ real(start)
    np.testing.assert_allclose(end, nearest, atol=1e-9)


def test_followers_complete_the_shape_of_their_leaders() -> None:
    rng = np.random.default_rng(8)
    shape, start = cloud(rng, 12), cloud(rng, 12)
    leaders = np.setdiff1d(np.arange(12), follower_links(shape)[:, 0])
    end = flow(LAWS["matrix-weighted"].make(shape, GAIN), start, 200.0, step_s=0.1)
    assert leaders.size == 2 and (end[leaders] == start[leaders]).all()
    assert fit_shape(shape, end).error < 1e-12


@pytest.mark.parametrize("count", [3, 5, 16, 40])
def test_followers_have_two_robots_before_them_and_no_cycle(count) -> None:
    links = follower_links(cloud(np.random.default_rng(count), count))
    followers, times = np.unique(links[:, 0], return_counts=True)
    assert followers.size == count - 2 and (times == 2).all()
    placed = set(range(count)) - set(followers.tolist())
    for (follower, one), (same, other) in links.reshape(-1, 2, 2).tolist():
        assert follower == same and {one, other} <= placed and one != other
        placed.add(follower)


def module_cost(shape: np.ndarray, places: np.ndarray) -> float:
    """Return half the minimum sum of squared distances from an affine image, fitted module by module."""
    cost = 0.0
    for robots in modules(shape):
        points = np.stack([np.ones(4), shape[robots].real, shape[robots].imag], axis=1)
        at = np.stack([places[robots].real, places[robots].imag], axis=1)
        cost += float(np.sum((at - points @ np.linalg.lstsq(points, at)[0]) ** 2)) / 2
    return cost


def distance_cost(shape: np.ndarray, places: np.ndarray) -> float:
    first, second = neighbors(shape).T
    now, wanted = (np.abs(points[second] - points[first]) ** 2 for points in (places, shape))
    return float(np.sum((now - wanted) ** 2)) / 4


def corner_cost(shape: np.ndarray, places: np.ndarray, part) -> float:
    """Return half the sum of squared errors of a part of log((z_k - z_i) / (z_j - z_i)) over all corners."""
    cost = 0.0
    for corners in triangles(shape):
        for i, j, k in (corners, np.roll(corners, 1), np.roll(corners, 2)):
            now, wanted = ((points[k] - points[i]) / (points[j] - points[i]) for points in (places, shape))
            cost += part(np.log(now / wanted)) ** 2 / 2
    return cost


GRADIENTS = {
    "affine-modules": module_cost,
    "distances": distance_cost,
    "angles": partial(corner_cost, part=np.imag),
    "distance-ratios": partial(corner_cost, part=np.real),
}


@pytest.mark.parametrize(("method", "cost"), GRADIENTS.items(), ids=GRADIENTS)
def test_a_gradient_law_descends_the_cost_of_its_paper(method, cost) -> None:
    """The test compares direction and sign; the factor follows from the rate."""
    rng = np.random.default_rng(9)
    shape, places = cloud(rng, 9), cloud(rng, 9)
    slope = []
    for column in range(18):
        off = np.zeros(9, dtype=complex)
        off[column % 9] = 1e-6 * (1 if column < 9 else 1j)
        slope.append((cost(shape, places + off) - cost(shape, places - off)) / 2e-6)
    down, velocity = -np.array(slope), real(LAWS[method].make(shape, GAIN)(places))
    np.testing.assert_allclose(
        velocity / np.linalg.norm(velocity), down / np.linalg.norm(down), rtol=0, atol=1e-7
    )


@pytest.mark.parametrize("method", CORNERS)
def test_corner_laws_keep_centroid_and_size(method) -> None:
    """Their costs do not depend on either; Euler steps leave the sphere of the flow by O(step).

    The shape has no flat triangles, whose modes are slow.
    """
    rng = np.random.default_rng(13)
    shape = grid(3, 3) + 0.1 * cloud(rng, 9)
    start = 3.0j * shape + 0.3 * cloud(rng, 9)
    end = flow(LAWS[method].make(shape, GAIN), start, 400.0, step_s=0.05)
    assert fit_shape(shape, end).error < 1e-3 < fit_shape(shape, start).error
    assert abs(end.mean() - start.mean()) < 1e-9
    assert np.std(end) == pytest.approx(np.std(start), rel=1e-2)


@pytest.mark.parametrize("seed", range(5))
def test_mean_shift_fills_shape_without_roles(seed) -> None:
    """Robots in any order end on the points, one on each; fixed roles would be wrong in nearly all orders."""
    rng = np.random.default_rng(seed)
    shape = grid(3, 3)
    start = rng.permutation(shape) + 0.4 * cloud(rng, 9)
    end = flow(mean_shift_law(shape, GAIN), start, 120.0)
    distances = np.abs(end[:, None] - (shape - shape.mean() + end.mean()))
    assert distances.min(axis=1).max() < 1e-6
    assert sorted(distances.argmin(axis=1).tolist()) == list(range(9))


def test_mean_shift_leaves_occupied_place_to_its_holder() -> None:
    """The third robot is nearer to the middle place, which the second one holds: it is drawn to the right."""
    places = np.array([-1.1, 0.2, 0.9]) + 0j
    law = mean_shift_law(np.array([-2.0, 0.0, 2.0]) + 0j, GAIN)
    pushed = (1.6 / 0.7 - 1) * 0.7  # from the second robot; the first is out of reach
    assert law(places)[2] == pytest.approx(GAIN * (2.0 - 0.9 + pushed))


@pytest.mark.parametrize("count", [4, 7, 16])
def test_modules_are_interlaced_with_affine_images_as_kernel(count) -> None:
    """Aranda and Perez-Yus: modules that share three robots; the matrix then has rank N - 3."""
    shape = cloud(np.random.default_rng(count), count)
    groups, rows = modules(shape), module_rows(shape)
    reached, ahead = {0}, [0]
    while ahead:
        robots = set(groups[ahead.pop()].tolist())
        near = {i for i, other in enumerate(groups.tolist()) if len(robots & set(other)) == 3} - reached
        reached |= near
        ahead += near
    assert len(reached) == len(groups)
    assert np.linalg.matrix_rank(rows) == count - 3
    np.testing.assert_allclose(np.linalg.norm(rows, axis=1), 1.0, atol=1e-12)


def test_stress_weights_are_the_best_of_their_kind() -> None:
    """A-optimal design: no weight's share in the trace is above it; the slowest mode is faster."""
    shape = cloud(np.random.default_rng(10), 12)
    rows, matrix = module_rows(shape), stress_matrix(shape)
    assert np.trace(matrix) == pytest.approx(1.0)
    inverse = np.linalg.pinv(matrix, hermitian=True)
    shares = ((rows @ inverse) ** 2).sum(axis=1) / np.trace(inverse)
    assert shares.max() == pytest.approx(1.0, abs=0.02)
    equal = rows.T @ rows
    slow = [np.linalg.eigvalsh(m)[3] / np.linalg.eigvalsh(m)[-1] for m in (equal, matrix)]
    assert np.linalg.matrix_rank(matrix) == 9 and slow[1] > slow[0]


def test_distances_alone_may_end_in_a_wrong_framework() -> None:
    """The paper proves local convergence: a start near the shape converges, and some others do not."""
    rng = np.random.default_rng(11)
    shape = cloud(rng, 9)
    law = distance_law(shape, GAIN)
    start = shape + 0.02 * cloud(rng, 9)
    near = flow(law, start, 400.0, step_s=0.2)
    assert fit_shape(shape, near).error < 0.01 * fit_shape(shape, start).error
    ends = [flow(law, cloud(rng, 9), 200.0, step_s=0.02) for _ in range(4)]
    assert max(fit_shape(shape, end).error for end in ends) > 0.05


def test_points_along_a_line_make_no_triangles_by_rounding() -> None:
    """Robots along the sides of a triangle are collinear up to rounding: some triangles are degenerate."""
    points = shape_points("triangle", 15) @ np.array([1, 1j])
    points = points + 1e-9 * cloud(np.random.default_rng(12), 15)
    corners = triangles(points)
    a, b, c = points[corners].T
    assert (
        len(corners) == 13
    )  # of any triangulation: 2 N - 2 - all points of the hull, which are on the sides
    assert (np.abs(((b - a).conj() * (c - b)).imag) > 1e-3).all()


@pytest.mark.parametrize("count", [3, 4, 9, 30])
def test_complex_laplacian_is_stable_and_keeps_similar_shapes(count) -> None:
    """Lin et al., Theorem 3.1: Lz = 0 for z = a 1 + b shape; with rank N - 2, for no other z."""
    rng = np.random.default_rng(count)
    shape = cloud(rng, count)
    matrix = complex_laplacian(shape)
    np.testing.assert_allclose(matrix, matrix.conj().T, atol=1e-14)
    values = np.linalg.eigvalsh(matrix)
    assert np.abs(values[:2]).max() < 1e-12 * values[-1] * count
    assert count == 2 or values[2] > 1e-6 * values[-1]
    a, b = cloud(rng, 2)
    assert np.abs(matrix @ (a + b * shape)).max() < 1e-12 * np.abs(b * shape).max() * count


def test_bearings_alone_keep_centroid_and_size_and_give_turn() -> None:
    """Zhao and Zelazo, Theorem 9: almost any start converges to the shape, with its size unchanged."""
    rng = np.random.default_rng(5)
    shape, start = cloud(rng, 10), 3.0 * cloud(rng, 10)
    end = flow(bearing_only_law(shape, GAIN), start, 600.0, step_s=0.05)
    found = fit_shape(shape, end)
    assert found.error < 1e-3
    assert found.rotation_rad == pytest.approx(0.0, abs=1e-3)
    assert abs(end.mean() - start.mean()) < 1e-9
    # Euler steps are tangents of the sphere that contains the flow: they leave it by O(step).
    assert np.std(end) == pytest.approx(np.std(start), rel=1e-2)


def test_a_shape_in_a_line_has_no_triangles() -> None:
    for points in (np.arange(5.0) + 0j, (1 + 0.3j) * np.arange(5.0)):
        for method in LAWS.keys() - {"mean-shift"}:
            with pytest.raises(InputError, match="line"):
                LAWS[method].make(points, GAIN)


def test_three_robots_make_no_module() -> None:
    with pytest.raises(InputError, match="at least 4"):
        LAWS["affine-modules"].make(np.array([0, 1, 1j]), GAIN)


def last_step(*settings: str):
    """Return the mission and last step of a team near its shape, whose units lose every image."""
    near = [
        "perception=ideal",
        "roles.exchange=false",
        "avoidance.on=false",
        "size.min_spacing_sides=0",
        "robots.body_radius_sides=0",
        "robots.scatter.scale_m=2.6",
        "robots.scatter.jitter_m=0.5",
        "network.frame_loss=0.99999",
        "step_s=0.2",
        "units.*.frame_rate_hz=1",
    ]
    mission = load_mission("crowd", [*near, *settings])
    *_, last = run_steps(mission)
    return mission, last


@pytest.mark.parametrize("method", LAWS)
def test_robots_with_true_positions_form_shape_without_units(method) -> None:
    """The error is as small as the paper proves; the test below shows the initial error."""
    size = ["size.unit_m=2.6"] if LAWS[method].needs_size else []
    k_ps = 4.8 if method in CORNERS else 2.4
    mission, last = last_step(f"control.method={method}", f"control.k={k_ps}", "duration_s=50", *size)
    shape, places = mission.template.points_of(mission.ids).conj(), last.positions_m @ np.array([1, 1j])
    similar = fit_shape(shape, places).error
    assert affine_error(shape, places) < 0.01
    assert similar > 0.015 if method in AFFINE else similar < 0.01


def test_robots_of_the_units_law_then_stand_still() -> None:
    assert last_step("duration_s=5")[1].metrics.shape.error > 0.1


def test_a_law_of_distances_asks_for_the_size() -> None:
    with pytest.raises(InputError, match=r"size\.unit_m"):
        last_step("control.method=distances")


def test_a_law_of_ones_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The module is in the working directory; a law of all robots' centroids needs no neighbours."""
    (tmp_path / "own_law.py").write_text(
        "def gather(shape, gain_ps):\n    return lambda places: gain_ps * (places.mean() - places)\n"
        "def short(shape, gain_ps):\n    return lambda places: places[:3]\n"
        "def endless(shape, gain_ps):\n    return lambda places: places * float('inf')\n"
    )
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(str(tmp_path))
    _, last = last_step("control.method=own_law:gather", "control.k=1", "duration_s=20")
    assert np.ptp(last.positions_m, axis=0).max() < 1e-3
    for name in ("short", "endless"):
        with pytest.raises(InputError, match="a finite complex velocity for each robot"):
            last_step(f"control.method=own_law:{name}")
    with pytest.raises(InputError, match="no attribute 'none'"):
        last_step("control.method=own_law:none")


def test_unknown_law_is_refused_with_names_of_all_laws() -> None:
    with pytest.raises(InputError, match=r"affine-stress.*module:factory") as refusal:
        load_mission("crowd", ["control.method=affine"])
    assert "\n" not in str(refusal.value)


@pytest.mark.parametrize(
    ("key", "given"),
    [
        ("roles", {"exchange": True}),
        ("template", {"shape": "triangle", "motion": [{"at_s": 1.0, "turn_degps": 2.0}]}),
        ("control", {"gains": "pixel", "method": "bearing-only"}),
    ],
)
def test_what_a_law_from_the_literature_does_not_know_is_refused(scenario_tree, key, given) -> None:
    tree = scenario_tree("triangle")
    tree["control"] = {"method": "bearing-only"}
    with pytest.raises(InputError, match=r"not supported by control\.method bearing-only"):
        make_mission(tree | {key: given})
