"""The detour `nearest`, the filter of a control barrier function, against a general optimizer."""

import numpy as np
import pytest
from scipy.optimize import minimize

from skyherd.control.avoidance.detour import DETOUR_RULES, nearest


def random_bounds(rng: np.random.Generator, robots: int, bodies: int):
    rows = np.repeat(np.arange(robots), bodies)
    return rows, rng.uniform(-np.pi, np.pi, rows.size), rng.uniform(0.0, 0.3, rows.size)


@pytest.mark.parametrize("seed", range(8))
def test_nearest_velocity_matches_general_optimizer(seed) -> None:
    """The reference is SLSQP on the quadratic program; its tolerance is 1e-10 of the squared distance."""
    rng = np.random.default_rng(seed)
    rows, bearings, speeds = random_bounds(rng, robots=6, bodies=5)
    preferred = rng.uniform(0.1, 0.6, 6) * np.exp(1j * rng.uniform(-np.pi, np.pi, 6))
    blocked, found = nearest(preferred, rows=rows, bearings_rad=bearings, speeds_mps=speeds)
    towards = np.stack([np.cos(bearings), np.sin(bearings)], axis=1)
    for robot in range(6):
        own, wanted = rows == robot, np.array([preferred[robot].real, preferred[robot].imag])
        excess = towards[own] @ wanted - speeds[own]
        assert (robot in blocked) == (excess > 0).any()
        if robot not in blocked:
            continue
        got = found[np.searchsorted(blocked, robot)]
        best = minimize(
            lambda u, wanted=wanted: np.sum((u - wanted) ** 2),
            np.zeros(2),
            method="SLSQP",
            constraints={"type": "ineq", "fun": lambda u, own=own: speeds[own] - towards[own] @ u},
            options={"ftol": 1e-14},
        ).x
        assert got == pytest.approx(complex(best[0], best[1]), abs=1e-5)
        assert (towards[own] @ [got.real, got.imag] <= speeds[own] + 1e-12).all()


def test_nearest_velocity_slides_along_one_body() -> None:
    """A body ahead to the left at 45 degrees, with no approach allowed: the component along it remains."""
    _, found = nearest(
        np.array([1.0 + 0j]), rows=np.array([0]), bearings_rad=np.array([np.pi / 4]), speeds_mps=np.zeros(1)
    )
    assert found[0] == pytest.approx(0.5 - 0.5j)


def test_nearest_velocity_between_closing_bodies_is_standstill() -> None:
    """Three bodies around the robot allow no velocity but zero."""
    bearings = np.array([0.0, 2 * np.pi / 3, -2 * np.pi / 3])
    bounds = {"rows": np.zeros(3, dtype=int), "bearings_rad": bearings, "speeds_mps": np.zeros(3)}
    _, found = nearest(np.array([0.5 + 0.1j]), **bounds)
    assert abs(found[0]) < 1e-9
    _, found = DETOUR_RULES["around"](np.array([0.5 + 0.1j]), **bounds)
    assert abs(found[0]) < 1e-9
