"""Least-squares similarity from template to image (paper, eq. 1 and Algorithm 1), and desired points.

Points are complex numbers `u + iv`. A proper similarity is then `z ↦ a (z - c) + d` with one complex factor
`a = s e^{iφ}`: scale s, rotation φ. Bounds on the scale keep the shape above a minimum size. The fit remains
a least-squares fit among the similarities within the bounds. The Lyapunov function V (paper, eq. 9) therefore
keeps its gradient, current minus desired point, and still decreases (docs/bodies.md, "Size").
"""

import math
from dataclasses import dataclass

import numpy as np

from skyherd.errors import DegenerateSetError, SingularSetError
from skyherd.geometry import Array, BoolArray, ComplexArray, IntArray
from skyherd.messages.checks import check_vectors

COINCIDENT = 1e-12
"""Points closer to their centroid than this share of their distance from the origin coincide. Chosen: 10^4
times the rounding of a coordinate (2^-53); a pixel is 1e-4 of the largest coordinate."""

VANISHING = 1e-9
"""A fit has scale zero if it explains less than the square of this share of the squared spread. Chosen: above
the rounding of a sum of some hundred products (1e-14), so that singular and poor fits differ."""

MIN_SHARE = 0.01
"""Minimum scale of the goals' similarity, as a share of the RMS spread of the current points over the
template's. Chosen: one in 2500 random starts of six robots is below, as the share explained is Beta(1, 4)."""


MAX_SCALE = 1e30
"""Largest scale of a fit. Chosen: above the ratio of any two images; coordinates of 1e6 px stay finite to the
eighth power."""


@dataclass(frozen=True)
class Similarity:
    """Map `z ↦ factor (z - source) + target`, from centroid to centroid.

    Attributes:
        factor: H_s of the paper (eq. 1) as one complex number, `s e^{iφ}`.
        source: centroid of the points to map.
        target: centroid of their images.
    """

    factor: complex
    source: complex
    target: complex

    @property
    def scale(self) -> float:
        """Scale s_j: image pixels per template pixel."""
        return abs(self.factor)

    @property
    def rotation_rad(self) -> float:
        """Rotation φ_j in (-pi, pi], positive from +u to +v."""
        return float(np.angle(self.factor))

    def resized(self, low: float, high: float) -> "Similarity":
        """Return the same similarity with its scale clipped to two bounds, about the centroids.

        It is the best fit of all similarities within the bounds. For a given rotation the residual is
        quadratic in the scale, and the best rotation does not depend on the scale.
        """
        if low <= self.scale <= high:
            return self
        scale = min(max(self.scale, low), high)
        return Similarity(self.factor / self.scale * scale, self.source, self.target)

    def __call__(self, points: ComplexArray) -> ComplexArray:
        """Return images (N,) of points (N,)."""
        return np.asarray(self.factor * (points - self.source) + self.target)


def fit_similarity(template: ComplexArray, current: ComplexArray) -> Similarity:
    """Fit the least-squares similarity from template points (N,) to current points (N,).

    It minimises `Σ |H p'_ic - p_ic|²` over `H = s e^{iφ}`, with both sets centred (paper, eq. 1 and Algorithm
    1; Gower 2004). In complex numbers the solution of the normal equation is

        H = Σ conj(p'_ic) p_ic / Σ |p'_ic|².

    Raises:
        DegenerateSetError: there are fewer than two points; or all template points coincide, so that no
            similarity exists; or all current points coincide, so that its scale is zero; or the best scale is
            zero (the singular arrangements of the paper's Remark 2).
    """
    check_vectors("fit_similarity", template=template, current=current)
    if template.size != current.size or template.size < 2:
        raise DegenerateSetError("current points", f"{current.size} define no similarity", "at least two")
    source, target = template.sum() / template.size, current.sum() / current.size
    template_c, current_c = template - source, current - target
    spread = np.vdot(template_c, template_c).real
    if spread <= (COINCIDENT * np.abs(template).max()) ** 2 * template.size:
        raise DegenerateSetError("template points", "all coincide", "at least two that differ")
    if np.abs(current_c).max() <= COINCIDENT * np.abs(current).max():
        raise DegenerateSetError("current points", "all coincide", "at least two that differ")
    factor = complex(np.vdot(template_c, current_c) / spread)
    if not abs(factor.real) + abs(factor.imag) <= MAX_SCALE:
        raise DegenerateSetError("template points", "nearly coincide", "at least two that differ")
    if abs(factor) ** 2 * spread <= VANISHING**2 * np.vdot(current_c, current_c).real:
        raise SingularSetError(
            "current points", "the best similarity has size zero", "points for which one rotation is best"
        )
    return Similarity(factor, complex(source), complex(target))


def fit_goals(template: ComplexArray, current: ComplexArray) -> Similarity:
    """Fit the similarity (see `fit_similarity`); near a singular arrangement return one that leads out of it.

    Let `t` and `x` be the centred template and current points, and `x = a t + y` with y orthogonal to t. The
    law `x' = -k (x - H t)` with the best-fitting `H = a` makes y decay and keeps a constant. If a is 0, no
    rotation fits best (the paper's Remark 2). The scale is therefore at least `MIN_SHARE |x| / |t|`. The
    rotation is that of the best fit, or the template's own rotation in the image if the best is undefined. y
    then decays as before, and V with it, while a grows from 0 to `MIN_SHARE / e` of the initial x. Bounds on
    the size prevent such a small shape (`skyherd.control.formation.size`).

    Raises:
        DegenerateSetError: as `fit_similarity`, except for the singular arrangements.
    """
    try:
        best = fit_similarity(template, current)
    except SingularSetError:
        best = Similarity(0j, complex(template.mean()), complex(current.mean()))
    least = MIN_SHARE * _length(current - best.target) / _length(template - best.source)
    if best.scale >= least:
        return best
    direction = best.factor / best.scale if best.scale else 1.0
    return Similarity(least * direction, best.source, best.target)


def _length(vector: ComplexArray) -> float:
    """Return the Euclidean length of a vector (N,). `numpy.linalg.norm` takes twice as long for a few."""
    return math.sqrt(np.vdot(vector, vector).real)


@dataclass(frozen=True)
class Similarities:
    """G similarities `z ↦ factor (z - source) + target` as arrays.

    Attributes:
        factors: (G,) complex factors `s e^{iφ}`; 0 where there is no similarity.
        sources: (G,) centroids of the points to map.
        targets: (G,) centroids of their images.
        exist: (G,) mask of the groups that define a similarity.
    """

    factors: ComplexArray
    sources: ComplexArray
    targets: ComplexArray
    exist: BoolArray

    def __call__(self, points: ComplexArray, group: IntArray) -> ComplexArray:
        """Return images (N,) of points (N,), each by the similarity of its group (N,)."""
        return np.asarray(self.factors[group] * (points - self.sources[group]) + self.targets[group])


def fit_similarities(
    template: ComplexArray, current: ComplexArray, *, group: IntArray, groups: int
) -> Similarities:
    """Fit the similarities of many groups of points at once, each as in `fit_similarity`.

    The cost is a few array operations for any number of groups. `exist` marks groups that `fit_similarity`
    would reject with an error.

    Args:
        template: (N,) template points of all groups.
        current: (N,) current points.
        group: (N,) number of each point's group, 0 to `groups` - 1.
        groups: G.
    """

    def total(values: Array) -> Array:
        return np.asarray(np.bincount(group, weights=values, minlength=groups), dtype=float)

    def complex_total(points: ComplexArray) -> ComplexArray:
        return np.asarray(total(points.real) + 1j * total(points.imag))

    def largest(points: ComplexArray) -> Array:
        most = np.zeros(groups)
        np.maximum.at(most, group, np.abs(points))
        return most

    check_vectors("fit_similarities", template=template, current=current, group=group)
    sizes = np.bincount(group, minlength=groups)
    counts = np.maximum(sizes, 1)
    sources, targets = complex_total(template) / counts, complex_total(current) / counts
    template_c, current_c = template - sources[group], current - targets[group]
    product = complex_total(template_c.conj() * current_c)
    spread = total(template_c.real**2 + template_c.imag**2)
    explained = product.real**2 + product.imag**2
    exist = (sizes >= 2) & (spread > (COINCIDENT * largest(template)) ** 2 * sizes)
    exist &= largest(current_c) > COINCIDENT * largest(current)
    exist &= explained > VANISHING**2 * spread * total(current_c.real**2 + current_c.imag**2)
    factors = product / np.where(exist, spread, 1.0)
    exist &= np.abs(factors.real) + np.abs(factors.imag) <= MAX_SCALE
    return Similarities(factors=np.where(exist, factors, 0), sources=sources, targets=targets, exist=exist)


def desired_points(template: ComplexArray, current: ComplexArray) -> ComplexArray:
    """Return the desired image points `p^d = H_s p'_c + c_p` (N,) of the robots (paper, Algorithm 1).

    Args:
        template: (N,) template points p' of the robots that the unit controls.
        current: (N,) their points p in the unit's image.

    Raises:
        DegenerateSetError: the points define no similarity, as for `fit_similarity`.
    """
    return fit_similarity(template, current)(template)
