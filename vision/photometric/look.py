"""What one look at an image saw: quadrilaterals, which of them were fitted, and which fits are markers."""

from dataclasses import dataclass

import numpy as np

from skyherd.geometry import Array, BoolArray
from skyherd.vision.photometric.fitting.fit_result import FitResults, no_fit_results
from skyherd.vision.search.decode import DecodedQuads, no_decoded_quads


@dataclass(frozen=True)
class Look:
    """What one look at an image saw.

    Attributes:
        quads_px: (Q, 4, 2) corners of all quadrilaterals that were found, px.
        candidates: the N of them that resemble a marker, the best of each place.
        fits: of the N candidates, in their order.
        good: (N,) which fits are verified, and the best of each place.
    """

    quads_px: Array
    candidates: DecodedQuads
    fits: FitResults
    good: BoolArray

    @property
    def found(self) -> FitResults:
        """The fits that are good."""
        return self.fits.take(self.good)

    @classmethod
    def of_nothing(cls, dictionary: str) -> "Look":
        """Return a look that saw no quadrilateral; `dictionary` is that of the markers."""
        nothing = np.zeros(0, dtype=bool)
        return cls(np.zeros((0, 4, 2)), no_decoded_quads(), no_fit_results(dictionary), nothing)

    def joined(self, other: "Look") -> "Look":
        """Return a look that saw what this one did, followed by what the other did."""
        return Look(
            np.concatenate([self.quads_px, other.quads_px]),
            self.candidates.joined(other.candidates),
            self.fits.joined(other.fits),
            np.concatenate([self.good, other.good]),
        )
