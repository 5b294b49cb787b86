"""The least-squares similarity from template to image (paper, eq. 1 and Algorithm 1), and desired points.

Points are complex numbers `u + iv`, so that a proper similarity is `z ↦ a (z - c) + d` with one complex
factor `a = s e^{iφ}`: scale s, rotation φ. Bounds on the scale keep the shape above a smallest size: the fit
stays a least-squares fit among the similarities within the bounds, so that V (paper, eq. 9) is still a cost
whose gradient is current minus desired point, and still falls (docs/bodies.md, "Size").
"""

from dataclasses import dataclass

import numpy as np

from skyherd.errors import DegenerateSetError, SingularSetError
from skyherd.geometry import Array, BoolArray, ComplexArray, IntArray
from skyherd.messages.checks import check_vectors

COINCIDENT = 1e-12
"""Points whose distances from their centroid are below this share of their distance from the origin count as
one point. Chosen: 10^4 times the rounding of a coordinate (2^-53 = 1e-16), so that what is left is digits;
and far below any image, where a pixel is 1e-4 of the largest coordinate."""

VANISHING = 1e-9
"""A fit counts as having scale zero if it explains less than the square of this share of the points' squared
spread. Chosen: above the rounding of a sum of some hundred products (1e-14), so that a square fitted to its
mirror image, which is best fitted by scale zero, is told apart from a poor fit."""

MIN_SHARE = 0.01
"""Least scale of the goals' similarity, as a share of the root mean square distance of the current points
over that of the template. Chosen: the fit of a start that is below explains less than a ten-thousandth of its
squared spread, as of one start in 2500 of six robots at random places (the share explained has the
distribution Beta(1, 4)), so that the law is the paper's for all others."""


@dataclass(frozen=True)
class Similarity:
    """The map `z ↦ factor (z - source) + target`, which takes centroid to centroid.

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
        """Scale s_j: image pixels for a template pixel."""
        return abs(self.factor)

    @property
    def rotation_rad(self) -> float:
        """Rotation φ_j in (-pi, pi], positive from +u to +v."""
        return float(np.angle(self.factor))

    def resized(self, low: float, high: float) -> "Similarity":
        """The same similarity with its scale brought between two bounds, about the centroids.

        Of all similarities within the bounds it fits best: for a given rotation the residual is quadratic in
        the scale, and the best rotation does not depend on the scale.
        """
        if low <= self.scale <= high:
            return self
        scale = min(max(self.scale, low), high)
        return Similarity(self.factor / self.scale * scale, self.source, self.target)

    def __call__(self, points: ComplexArray) -> ComplexArray:
        """Images (N,) of points (N,)."""
        return np.asarray(self.factor * (points - self.source) + self.target)


def fit_similarity(template: ComplexArray, current: ComplexArray) -> Similarity:
    """The similarity that takes template points (N,) nearest to current points (N,).

    It minimises `Σ |H p'_ic - p_ic|²` over `H = s e^{iφ}`, with both sets centred (paper, eq. 1 and
    Algorithm 1; Gower 2004). In complex numbers the normal equation is

        H = Σ conj(p'_ic) p_ic / Σ |p'_ic|².

    Raises:
        DegenerateSetError: there are fewer than two points; or all template points coincide, so that no
            similarity exists; or all current points do, so that its scale is zero; or the best scale is zero
            (the singular arrangements of the paper's Remark 2).
    """
    check_vectors("fit_similarity", template=template, current=current)
    if template.size != current.size or template.size < 2:
        raise DegenerateSetError(f"{current.size} points define no similarity; at least two are needed")
    source, target = template.sum() / template.size, current.sum() / current.size
    template_c, current_c = template - source, current - target
    spread = np.vdot(template_c, template_c).real
    if spread <= (COINCIDENT * np.abs(template).max()) ** 2 * template.size:
        raise DegenerateSetError("all template points coincide; at least two must differ")
    if np.abs(current_c).max() <= COINCIDENT * np.abs(current).max():
        raise DegenerateSetError("all current points coincide; at least two must differ")
    factor = complex(np.vdot(template_c, current_c) / spread)
    if abs(factor) ** 2 * spread <= VANISHING**2 * np.vdot(current_c, current_c).real:
        raise SingularSetError("the best-fitting similarity has size zero, so no rotation fits best")
    return Similarity(factor, complex(source), complex(target))


def fit_goals(template: ComplexArray, current: ComplexArray) -> Similarity:
    """The similarity (see `fit_similarity`), or near a singular arrangement one that leads out of it.

    With `t` and `x` the centred template and current points, `x = a t + y` and y at right angles to t, the
    law `x' = -k (x - H t)` with the best-fitting `H = a` lets y die out and leaves a as it is. Where a is 0
    no rotation fits best (the paper's Remark 2). So the scale is at least `MIN_SHARE |x| / |t|`, with the
    rotation of the best fit, or the template's own in the image where there is none. y dies out as before,
    and with it V, and a grows: from 0 to `MIN_SHARE / e` of what x was at the start. A shape so small is
    what bounds on its size are for (`skyherd.control.formation.size`).

    Raises:
        DegenerateSetError: as `fit_similarity`, but for the singular arrangements.
    """
    try:
        best = fit_similarity(template, current)
    except SingularSetError:
        best = Similarity(0j, complex(template.mean()), complex(current.mean()))
    spread = float(np.linalg.norm(current - best.target))
    least = MIN_SHARE * spread / float(np.linalg.norm(template - best.source))
    if best.scale >= least:
        return best
    direction = best.factor / best.scale if best.scale else 1.0
    return Similarity(least * direction, best.source, best.target)


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
        """Images (N,) of points (N,), each by the similarity of its group (N,)."""
        return np.asarray(self.factors[group] * (points - self.sources[group]) + self.targets[group])


def fit_similarities(
    template: ComplexArray, current: ComplexArray, *, group: IntArray, groups: int
) -> Similarities:
    """The similarities of many groups of points at once, each as `fit_similarity` has it.

    One fit for all units' sets, or for all reports, costs a few array operations, however many there are. A
    group that `fit_similarity` would refuse with an error is marked in `exist`.

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
    return Similarities(factors=np.where(exist, factors, 0), sources=sources, targets=targets, exist=exist)


def desired_points(template: ComplexArray, current: ComplexArray) -> ComplexArray:
    """Desired image points `p^d = H_s p'_c + c_p` (N,) of the robots (paper, Algorithm 1).

    Args:
        template: (N,) template points p' of the robots that the unit controls.
        current: (N,) their points p in the unit's image.

    Raises:
        DegenerateSetError: the points define no similarity, as for `fit_similarity`.
    """
    return fit_similarity(template, current)(template)
