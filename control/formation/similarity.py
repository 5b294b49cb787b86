"""Algorithm 1 of the paper: the least-squares similarity from template to image, and desired points."""

from dataclasses import dataclass

import numpy as np

from skyherd.errors import DegenerateSetError
from skyherd.geometry import Array, BoolArray, ComplexArray, IntArray

COINCIDENT = 1e-12
"""Points whose spread is below this fraction of their size lie on one spot."""

VANISHING = 1e-9
"""A fit that explains less than this share of the points' spread is no fit (a mirrored square, for one)."""


@dataclass(frozen=True)
class Similarity:
    """`z ↦ turn (z - source) + target`: scale `|turn|`, rotation `arg turn` (image sense), centroids kept."""

    turn: complex
    source: complex
    target: complex

    @property
    def scale(self) -> float:
        """s_j: image pixels per template pixel."""
        return abs(self.turn)

    @property
    def rotation_rad(self) -> float:
        """phi_j, from +u to +v."""
        return float(np.angle(self.turn))

    def resized(self, low: float, high: float) -> "Similarity":
        """The same with its scale kept between two bounds, about the centroids.

        Of all similarities within the bounds it is the nearest fit: for a given rotation the residual is
        quadratic in the scale, and the best rotation does not depend on the scale.
        """
        if low <= self.scale <= high:
            return self
        return Similarity(self.turn / self.scale * min(max(self.scale, low), high), self.source, self.target)

    def __call__(self, points: ComplexArray) -> ComplexArray:
        """Map template points to desired points."""
        return np.asarray(self.turn * (points - self.source) + self.target)


def fit_similarity(template: ComplexArray, current: ComplexArray) -> Similarity:
    """Similarity that takes template points (N,) nearest to current points (N,).

    Minimises `Σ |H p'_ic - p_ic|²` over `H = s e^{i phi}` with both sets centred (paper, eq. 1 and
    Algorithm 1). In complex numbers the normal equation is one line,

        H = Σ conj(p'_ic) p_ic / Σ |p'_ic|².

    Raises:
        DegenerateSetError: fewer than two points, or all template points (then no similarity exists) or
            all current points (then it has scale zero) on one spot, or a fit of size zero (the singular
            arrangements of the paper's Remark 2).
    """
    if template.size != current.size or template.size < 2:
        raise DegenerateSetError(f"{current.size} points define no similarity; at least two are needed")
    source, target = template.mean(), current.mean()
    template_c, current_c = template - source, current - target
    spread = np.vdot(template_c, template_c).real
    if spread <= (COINCIDENT * np.abs(template).max()) ** 2 * template.size:
        raise DegenerateSetError("all template points coincide; at least two must differ")
    if np.abs(current_c).max() <= COINCIDENT * np.abs(current).max():
        raise DegenerateSetError("all current points coincide; at least two must differ")
    turn = complex(np.vdot(template_c, current_c) / spread)
    if abs(turn) ** 2 * spread <= VANISHING**2 * np.vdot(current_c, current_c).real:
        raise DegenerateSetError("the best-fitting similarity has size zero, so no rotation fits best")
    return Similarity(turn, complex(source), complex(target))


@dataclass(frozen=True)
class Similarities:
    """G similarities `z ↦ turn (z - source) + target`, as arrays (G,); `exist` tells which there are."""

    turns: ComplexArray
    sources: ComplexArray
    targets: ComplexArray
    exist: BoolArray

    def __call__(self, points: ComplexArray, group: IntArray) -> ComplexArray:
        """Map template points (N,), each by the similarity of its group (N,)."""
        return np.asarray(self.turns[group] * (points - self.sources[group]) + self.targets[group])


def fit_similarities(
    template: ComplexArray, current: ComplexArray, group: IntArray, groups: int
) -> Similarities:
    """`fit_similarity` of many groups of points at once: point n belongs to `group[n]`, all (N,).

    A group that defines no similarity, for any reason that `fit_similarity` has to refuse one, gets none.
    """

    def total(values: Array) -> Array:
        return np.asarray(np.bincount(group, weights=values, minlength=groups), dtype=float)

    def mean(points: ComplexArray) -> ComplexArray:
        return np.asarray((total(points.real) + 1j * total(points.imag)) / np.maximum(sizes, 1))

    def largest(points: ComplexArray) -> Array:
        most = np.zeros(groups)
        np.maximum.at(most, group, np.abs(points))
        return most

    sizes = np.bincount(group, minlength=groups)
    sources, targets = mean(template), mean(current)
    template_c, current_c = template - sources[group], current - targets[group]
    product = template_c.conj() * current_c
    spread = total(template_c.real**2 + template_c.imag**2)
    explained = total(product.real) ** 2 + total(product.imag) ** 2
    exist = (sizes >= 2) & (spread > (COINCIDENT * largest(template)) ** 2 * sizes)
    exist &= largest(current_c) > COINCIDENT * largest(current)
    exist &= explained > VANISHING**2 * spread * total(current_c.real**2 + current_c.imag**2)
    turns = (total(product.real) + 1j * total(product.imag)) / np.where(exist, spread, 1.0)
    return Similarities(np.where(exist, turns, 0), sources, targets, exist)


def desired_points(template: ComplexArray, current: ComplexArray) -> ComplexArray:
    """p^d = H_s p'_c + c_p: where unit j wants its robots, in its own image (Algorithm 1)."""
    return fit_similarity(template, current)(template)
