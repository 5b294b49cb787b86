"""Evidence on unknowns as a quadratic form, and which of them have earned their place.

`x̂ = argmin ½ xᵀ Λ x - bᵀ x` over the unknowns that are let loose, the others being held at zero. To let
the group g loose beside those that are lowers the chi-squared by

    b̃ᵀ S⁻¹ b̃,   S = Λ_gg - Λ_ga Λ_aa⁻¹ Λ_ag,   b̃ = b_g - Λ_ga Λ_aa⁻¹ b_a.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from skyherd.geometry import Array, inverse


@dataclass(frozen=True)
class Information:
    """Λ (n, n) and b (n,)."""

    information: Array
    vector: Array

    @classmethod
    def none(cls, count: int) -> "Information":
        """Nothing is known of `count` unknowns."""
        return cls(np.zeros((count, count)), np.zeros(count))

    @classmethod
    def prior(cls, deviations: Array) -> "Information":
        """Each unknown is zero, give or take its deviation (n,)."""
        return cls(np.diag(deviations**-2.0), np.zeros(deviations.size))

    def __add__(self, other: "Information") -> "Information":
        return Information(self.information + other.information, self.vector + other.vector)

    def __sub__(self, other: "Information") -> "Information":
        return Information(self.information - other.information, self.vector - other.vector)

    def times(self, share: float) -> "Information":
        """Counted in part."""
        return Information(share * self.information, share * self.vector)

    def first(self, count: int) -> "Information":
        """What is told of the first unknowns, the others being whatever they are."""
        across = self.information[count:, :count]
        through = np.linalg.solve(self.information[count:, count:], across).T
        return Information(
            self.information[:count, :count] - through @ across,
            self.vector[:count] - through @ self.vector[count:],
        )

    def followed_by(self, others: "Information") -> "Information":
        """These unknowns and others that are independent of them."""
        count, size = self.vector.size, self.vector.size + others.vector.size
        information = np.zeros((size, size))
        information[:count, :count], information[count:, count:] = self.information, others.information
        return Information(information, np.concatenate([self.vector, others.vector]))

    def loosened(self, variances: Array) -> "Information":
        """After the unknowns may each have changed, with variances (n,)."""
        values, covariance = self.all_loose()
        information = inverse(covariance + np.diag(variances))
        return Information(information, information @ values)

    def all_loose(self) -> tuple[Array, Array]:
        """x̂ (n,) and its covariance (n, n) with every unknown let loose."""
        covariance = inverse(self.information)
        return covariance @ self.vector, covariance

    def solved(self, loose: Sequence[int]) -> Array:
        """x̂ (n,), with all but the unknowns `loose` held at zero."""
        values = np.zeros_like(self.vector)
        if loose:
            values[loose] = np.linalg.solve(self.information[np.ix_(loose, loose)], self.vector[loose])
        return values

    def earned(
        self, groups: Mapping[str, Sequence[int]], after: Mapping[str, str], least: float
    ) -> list[int]:
        """Unknowns of the groups that each lower the chi-squared by `least`, the most telling group first.

        A group that comes `after` another is asked once the other is in.
        """
        loose: list[int] = []
        left = np.column_stack([self.information, self.vector])
        waiting = dict(groups)
        while waiting:
            falls = {n: _fall(left, g) for n, g in waiting.items() if after.get(n) not in waiting}
            best = max(falls, key=falls.__getitem__)
            if falls[best] < least:
                break
            for k in waiting.pop(best):
                loose.append(k)
                # Eliminating what is loose leaves S and b̃ of all others in place.
                left = left - np.outer(left[:, k], left[k] / left[k, k])
        return loose


def _fall(left: Array, group: Sequence[int]) -> float:
    """Fall of chi-squared by a group, from S and b̃ (n, n + 1) of all."""
    vector = left[group, -1]
    if len(group) == 1:
        return float(vector[0] ** 2 / left[group[0], group[0]])
    return float(vector @ np.linalg.solve(left[group][:, group], vector))
