"""The plane that markers share, against cameras with tilt, aspect and skew, by projective geometry."""

from functools import partial

import numpy as np
import pytest
from scipy.special import bdtrik, chdtrc
from tests.helpers import plane_reference
from tests.helpers.fit_stages import stages
from tests.helpers.plane_reference import perspectives_at, variances_at

from skyherd.geometry import SQUARE_CORNERS
from skyherd.vision.photometric.fitting import plane as plane_module
from skyherd.vision.photometric.fitting.local_homography import LocalHomographies
from skyherd.vision.photometric.fitting.plane import SIGNIFICANT, Plane

POINTS = np.random.default_rng(0).uniform(-400, 400, (2, 16)).T @ np.array([1, 1j])


def fit_plane(points, anisotropies, variances, *, most=True):
    """Return the plane of the compiled fit."""
    limits = plane_module.plane_limits()
    return Plane.of_record(stages().fit_plane(points, anisotropies, variances, limits, most=most))


def random_homography(seed):
    """Ground to pixels from the image's centre, `K [r1 r2 t]`: aspect, skew, tilt up to 25 deg, any turn."""
    rng = np.random.default_rng(seed)
    focal, tilt, way = rng.uniform(600, 1200), np.radians(rng.uniform(2, 25)), rng.uniform(-np.pi, np.pi)
    intrinsic = np.array(
        [
            [focal, rng.uniform(-0.05, 0.05) * focal, rng.uniform(-40, 40)],
            [0, rng.uniform(0.9, 1.1) * focal, rng.uniform(-40, 40)],
            [0, 0, 1],
        ]
    )

    def about_z(angle):
        c, s = np.cos(angle), np.sin(angle)
        return np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])

    c, s = np.cos(tilt), np.sin(tilt)
    tilted = np.array([[1, 0, 0], [0, c, -s], [0, s, c]])
    rotation = about_z(way) @ tilted @ about_z(rng.uniform(-np.pi, np.pi))
    return intrinsic @ np.column_stack([rotation[:, :2], [rng.uniform(-1, 1), rng.uniform(-1, 1), 10.0]])


def mapped(homography, z):
    top = homography @ np.stack([np.real(z), np.imag(z), np.ones(np.shape(z))]).reshape(3, -1)
    return ((top[0] + 1j * top[1]) / top[2]).reshape(np.shape(z))


def squares_at(homography, points, side=0.3, seed=1):
    """Images of squares, at any heading, whose centres appear at `points`: by numerical Jacobians."""
    turns = side * np.exp(2j * np.pi * np.random.default_rng(seed).uniform(size=points.size))
    ground = mapped(np.linalg.inv(homography), points)
    h = 1e-5
    right, down = (
        (mapped(homography, ground + h * a * turns) - mapped(homography, ground - h * a * turns)) / (2 * h)
        for a in (1, 1j)
    )
    return (
        ground,
        turns,
        LocalHomographies(points, (right - 1j * down) / 2, (right + 1j * down) / 2, 0 * points),
    )


def plane_of(homography):
    """α from a square at the image's centre, λ from the image of the line at infinity, `H⁻ᵀ (0, 0, 1)`."""
    line = np.linalg.inv(homography)[2]
    _, _, middle = squares_at(homography, np.zeros(1, dtype=complex))
    anisotropy = complex(middle.anisotropies[0] / middle.similarities[0].conj())
    return Plane(anisotropy, -complex(line[0], line[1]) / line[2])


@pytest.mark.parametrize("seed", range(8))
def test_anisotropies_are_those_of_small_squares(seed):
    """Over the whole image, at every heading. Central differences leave h² = 1e-10 and rounding 1e-13 / h."""
    homography = random_homography(seed)
    _, _, homographies = squares_at(homography, POINTS)
    plane = plane_of(homography)
    seen = homographies.anisotropies / homographies.similarities.conj()
    assert np.abs(seen).max() > 0.002
    np.testing.assert_allclose(plane.anisotropies(POINTS), seen, atol=1e-7, rtol=0)


@pytest.mark.parametrize("seed", range(8))
def test_perspective_terms_reproduce_the_true_camera(seed):
    """The whole card, and points three sides away, as the homography maps them; Jacobians as above."""
    homography = random_homography(seed)
    ground, turns, homographies = squares_at(homography, POINTS)
    homographies = LocalHomographies(
        homographies.centers,
        homographies.similarities,
        homographies.anisotropies,
        perspectives_at(plane_of(homography), POINTS),
    )
    z = np.concatenate([SQUARE_CORNERS, 6 * SQUARE_CORNERS])
    truth = mapped(homography, ground[:, None] + turns[:, None] * z)
    np.testing.assert_allclose(homographies.images(z), truth, atol=1e-5, rtol=0)


@pytest.mark.parametrize("seed", range(8))
def test_the_plane_is_recovered_from_what_it_does_to_the_markers(seed):
    """Noise-free: of what is linear in λ, each of six rounds leaves |λ p| / 2 or less of the one before."""
    plane = plane_of(random_homography(seed))
    found = fit_plane(POINTS, plane.anisotropies(POINTS), np.full(POINTS.size, 1e-6))
    assert found.shared
    reach = np.abs(plane.perspective * POINTS).max()
    left = reach * (reach / 2) ** 6 + 1e-8  # a ridge of 1e-12 of the trace, |p|² = 1e5 of the rest
    assert left < 1e-5
    assert abs(found.anisotropy - plane.anisotropy) < left
    assert abs(found.perspective - plane.perspective) * np.abs(POINTS).max() < left
    np.testing.assert_allclose(found.anisotropies(POINTS), plane.anisotropies(POINTS), atol=left, rtol=0)


def noise(rng, sigma, count=POINTS.size):
    return sigma * (rng.normal(size=count) + 1j * rng.normal(size=count))


def chance(unknowns):
    """That noise alone earns further unknowns their place: two at a time, each pair by chi-squared of 2
    degrees, or of 4 for both at once; a bound, as these have chances in common."""
    return (2 if unknowns < 2 else 1) * chdtrc(2, SIGNIFICANT) + chdtrc(4, SIGNIFICANT)


def test_noise_alone_is_rarely_taken_for_a_plane():
    """Over 1000 seeds, no more often than chi-squared says, to the 1e-6 quantile of the binomial."""
    rng, sigma = np.random.default_rng(3), 1e-3
    found = [fit_plane(POINTS, noise(rng, sigma), np.full(POINTS.size, sigma**2)) for _ in range(1000)]
    alarms = sum(plane != Plane() for plane in found)
    assert alarms <= np.ceil(bdtrik(1 - 1e-6, 1000, chance(0))), alarms
    assert all(plane.shared for plane in found)


@pytest.mark.parametrize(("horizon", "unknowns"), [(0j, 2), (2e-4 - 1e-4j, 4)])
def test_the_simplest_plane_that_explains_is_taken(horizon, unknowns):
    """Pixels that are only oblong need no horizon, a tilt does; both are kept except for the noise's rate."""
    rng, sigma, plane = np.random.default_rng(4), 1e-3, Plane(0.03 + 0.01j, horizon)
    variances = np.full(POINTS.size, sigma**2)
    found = [fit_plane(POINTS, plane.anisotropies(POINTS) + noise(rng, sigma), variances) for _ in range(300)]
    as_simple = [f for f in found if f.shared and bool(f.perspective) == bool(horizon)]
    assert len(found) - len(as_simple) <= np.ceil(bdtrik(1 - 1e-6, 300, chance(unknowns)))
    # Sixteen anisotropies tell α to sigma / 4, a little less well beside λ: six deviations of each component.
    assert max(abs(f.anisotropy - plane.anisotropy) for f in as_simple) < 6 * sigma / 4 * 1.5


@pytest.mark.parametrize(("horizon", "count"), [(0j, 16), (2e-4 - 1e-4j, 16), (1e-4j, 3)])
def test_how_well_the_plane_is_known_is_told(horizon, count):
    """The anisotropies' errors over the variances stated have mean square 1: to 5 deviations of a mean of 800
    values, and 3 % for what is of second order in λ p."""
    rng, sigma, plane, points = np.random.default_rng(6), 1e-4, Plane(0.03 + 0.01j, horizon), POINTS[:count]
    squares = []
    for _ in range(400):
        seen = plane.anisotropies(points) + noise(rng, sigma, count)
        found = fit_plane(points, seen, np.full(count, sigma**2))
        if found.shared and bool(found.perspective) == bool(horizon):
            off = found.anisotropies(points) - plane.anisotropies(points)
            squares.append(np.mean(np.abs(off) ** 2 / variances_at(found, points)) / 2)
    assert len(squares) > 380
    assert np.mean(squares) == pytest.approx(1.0, abs=0.03 + 5 * np.sqrt(2 / 800))


@pytest.mark.parametrize("factor", [0.25, 2.0])
def test_scaled_plane_is_that_of_the_scaled_image(factor):
    """Anisotropies and their variances stay at each marker, and perspectives are per pixel."""
    covariance = np.array([[2e-6, 1e-9 - 3e-10j], [1e-9 + 3e-10j, 5e-12]])
    plane = Plane(0.05 - 0.02j, 3e-4 + 1e-4j, covariance=covariance)
    points = np.array([200 + 100j, -150 + 40j])
    scaled = plane.scaled(factor)
    np.testing.assert_allclose(scaled.anisotropies(factor * points), plane.anisotropies(points), rtol=1e-12)
    np.testing.assert_allclose(variances_at(scaled, factor * points), variances_at(plane, points), rtol=1e-12)
    expected = perspectives_at(plane, points) / factor
    np.testing.assert_allclose(perspectives_at(scaled, factor * points), expected)


def test_markers_under_a_bending_lens_share_no_plane():
    """A lens `p = q (1 + κ |q|²)` has anisotropy `κ q² / (1 + 2 κ |q|²)`, 0.02 or 20 sigma at 400 px."""
    kappa, sigma = -1.2e-7, 1e-3
    anisotropies = kappa * POINTS**2 / (1 + 2 * kappa * np.abs(POINTS) ** 2)
    rng = np.random.default_rng(5)
    for _ in range(50):
        found = fit_plane(POINTS, anisotropies + noise(rng, sigma), np.full(POINTS.size, sigma**2))
        assert not found.shared


def test_few_markers_take_as_simple_a_plane_as_they_can_tell():
    """One anisotropic marker tells no plane, two tell an anisotropy, three a tilt."""
    plane, variances = Plane(0.05 + 0.02j, 3e-4 + 1e-4j), np.full(16, 1e-10)
    anisotropies = plane.anisotropies(POINTS)
    assert not fit_plane(POINTS[:1], anisotropies[:1], variances[:1]).shared
    assert not fit_plane(POINTS[:2], anisotropies[:2], variances[:2]).shared
    assert fit_plane(POINTS[:2], anisotropies[[0, 0]], variances[:2]).shared
    assert fit_plane(POINTS[:3], anisotropies[:3], np.full(3, 1e-6)).shared
    assert fit_plane(POINTS[:1], np.zeros(1, dtype=complex), variances[:1]) == Plane()


@pytest.mark.parametrize("tilt_deg", [50, 60, 70])
def test_planes_at_steep_tilts_are_found_exactly(monkeypatch, tilt_deg):
    """A pinhole of focal length 1500 px; points are those of the tests above. Eight rounds of the iteration,
    the negative control, leave anisotropies off by more than their noise of 2e-4 at 70 degrees."""
    c, s = np.cos(np.radians(tilt_deg)), np.sin(np.radians(tilt_deg))
    tilted = np.array([[1, 0, 0], [0, c, -s], [0, s, c]])
    homography = np.diag([1500.0, 1500.0, 1.0]) @ np.column_stack([tilted[:, :2], [0, 0, 10.0]])
    points = POINTS * 0.5
    _, _, homographies = squares_at(homography, points)
    seen = homographies.anisotropies / homographies.similarities.conj()
    found = fit_plane(points, seen, np.full(16, 1e-8))
    np.testing.assert_allclose(found.anisotropies(points), seen, atol=1e-6, rtol=0)
    if tilt_deg == 70:
        monkeypatch.setattr(plane_module, "MAX_ROUNDS", 8)
        short = fit_plane(points, seen, np.full(16, 1e-8))
        assert np.abs(short.anisotropies(points) - seen).max() > 2e-4


KINDS = {
    "level": (0.0, 0.0),
    "anisotropic": (0.2, 0.0),
    "tilted": (0.1, 5e-4),
    "steep": (0.3, 2e-3),
    "none": (0.0, 0.0),
}


FITS = {
    "all": (partial(fit_plane, most=False), plane_reference.fit_plane_to_all),
    "most": (fit_plane, plane_reference.fit_plane),
}


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("asked", FITS)
def test_the_compiled_fit_is_that_of_numpy(kind, asked) -> None:
    """1 to 30 markers, some without information: α, λ, their covariance and whether a plane explains them.

    Where most are asked for, one of six lies elsewhere.
    """
    rng = np.random.default_rng([7, list(KINDS).index(kind)])
    anisotropy, horizon = KINDS[kind]
    shared = []
    for count in range(1, 31):
        turns = np.exp(1j * rng.uniform(-np.pi, np.pi, 2))
        points = rng.uniform(-400, 400, (count, 2)) @ np.array([1, 1j])
        variances = rng.uniform(1, 9, count) * 1e-6
        scatter = np.sqrt(variances) if kind != "none" else 0.1
        anisotropies = Plane(anisotropy * turns[0], horizon * turns[1]).anisotropies(points)
        anisotropies = anisotropies + scatter * (rng.normal(size=(count, 2)) @ np.array([1, 1j]))
        variances[rng.uniform(size=count) < 0.1] = np.inf
        if asked == "most":
            anisotropies[::6] += 0.05
        found, expected = (fit(points, anisotropies, variances) for fit in FITS[asked])
        assert found.shared == expected.shared
        np.testing.assert_allclose(found.anisotropy, expected.anisotropy, rtol=1e-9, atol=1e-12)
        np.testing.assert_allclose(found.perspective, expected.perspective, rtol=1e-9, atol=1e-15)
        np.testing.assert_allclose(found.covariance, expected.covariance, rtol=1e-9, atol=1e-24)
        shared.append(found.shared)
    if asked == "all":
        assert np.mean(shared) > 0.9 if kind not in ("none", "steep") else np.mean(shared) < 0.9
    elif kind not in ("none", "steep"):
        assert np.mean(shared) > 0.5
