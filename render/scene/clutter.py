"""Dark quadrilaterals on the ground that are no markers: what a detector has to leave alone."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from skyherd.errors import InputError
from skyherd.geometry import Array
from skyherd.render.scene.occluders import convex

MAX_QUADS = 200_000
"""Quadrilaterals that a view may have. *Chosen*: more is a mistake in the density, and would be drawn for
long."""

A_PERIOD = 1000
"""Quadrilaterals in the square that repeats. *Chosen*: views see few of them twice."""

WOBBLE_RAD = 0.35
"""Largest turn of a corner about the centre from a square's. *Chosen*: with radii up to a quarter off, most
shapes stay convex and none looks like a square."""

RADII = (0.75, 1.25)
"""Least and greatest distance of a corner from the centre, over a square's. *Chosen*: see `WOBBLE_RAD`."""


@dataclass(frozen=True)
class Clutter:
    """Convex quadrilaterals at random places, sizes and turns, fixed to the ground.

    They repeat with a period that holds `A_PERIOD` of them. A view has as many as its area times the density.

    Attributes:
        seed: of their places and shapes.
        density_per_m2: how many on a square metre.
        side_m: their least and greatest mean side.
        levels: least and greatest grey level.

    Raises:
        InputError: density or sides are not positive, or the sides are in the wrong order.
    """

    seed: int
    density_per_m2: float
    side_m: tuple[float, float]
    levels: tuple[float, float] = (10.0, 60.0)

    def __post_init__(self) -> None:
        if self.density_per_m2 <= 0 or not 0 < self.side_m[0] <= self.side_m[1]:
            raise InputError(
                "clutter",
                f"density_per_m2 {self.density_per_m2}, side_m {self.side_m}",
                "both positive, sides from least to greatest",
            )

    @property
    def period_m(self) -> float:
        """Side of the square that repeats, m."""
        return float(np.sqrt(A_PERIOD / self.density_per_m2))

    @cached_property
    def _one_period(self) -> tuple[Array, Array, Array]:
        """Centres (M, 2), corners about them (M, 4, 2) and levels (M,)."""
        rng = np.random.default_rng(self.seed)
        shapes = np.zeros((0, 4, 2))
        while len(shapes) < A_PERIOD:
            wobble = rng.uniform(-WOBBLE_RAD, WOBBLE_RAD, (A_PERIOD, 4))
            angle = np.pi / 2 * np.arange(4) + wobble + rng.uniform(0, 7, (A_PERIOD, 1))
            radius = rng.uniform(*RADII, (A_PERIOD, 4)) / np.sqrt(2)
            made = radius[..., None] * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
            shapes = np.concatenate([shapes, made[convex(made)]])
        sides = rng.uniform(*self.side_m, (A_PERIOD, 1, 1))
        return (
            rng.uniform(0, self.period_m, (A_PERIOD, 2)),
            shapes[:A_PERIOD] * sides,
            rng.uniform(*self.levels, A_PERIOD),
        )

    def within(self, low_m: Array, high_m: Array) -> tuple[Array, Array]:
        """Return corners (M, 4, 2), m, and levels (M,) of those that may reach into a box on the ground.

        The box is given by its lower and upper corner (2,), m.

        Raises:
            InputError: they are more than can be drawn.
        """
        centers, shapes, levels = self._one_period
        low, high = low_m - self.side_m[1], high_m + self.side_m[1]
        first, last = np.floor(low / self.period_m), np.floor(high / self.period_m)
        if float((last - first + 1).prod()) * A_PERIOD > MAX_QUADS:
            raise InputError(
                "clutter", f"more than {MAX_QUADS} quadrilaterals in view", "a smaller density_per_m2"
            )
        x, y = (np.arange(a, b + 1) * self.period_m for a, b in zip(first, last, strict=True))
        offsets = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 1, 2)
        places = (offsets + centers).reshape(-1, 2)
        near = np.flatnonzero(((places > low) & (places < high)).all(axis=1))
        return places[near, None] + shapes[near % A_PERIOD], levels[near % A_PERIOD]
