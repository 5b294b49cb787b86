"""Fits of all images of a board, and choice of the polynomial degree for each set's lens."""

from collections.abc import Mapping, Sequence

import numpy as np

from skyherd.bench.boards.board_errors import Fitted, learn_board_errors
from skyherd.bench.boards.board_fit import fit_board, robust_sigma
from skyherd.bench.photographs.sightings import Sightings
from skyherd.geometry import Array

DEGREES = (2, 3, 4, 5, 6, 7)
"""Candidate degrees of the polynomials. Chosen: the first corrects a rough homography; the last has as many
terms as nine markers have corners."""

TOLERANCE = 0.03
"""Relative increase of the errors at which a lower degree is still chosen. Chosen: about the random error of
a standard deviation from a thousand residuals."""

ImagesOfSets = Mapping[str, Sequence[Mapping[str, Sightings]]]
"""Detections of each detector, by its name, in each image of each set of a board, by the set's name."""


def fit_images(corners: dict[int, Array], found: ImagesOfSets, degrees: Mapping[str, int]) -> list[Fitted]:
    """Fit the board to all detections, with the degree of each set; images are numbered through all sets.

    Args:
        corners: (4, 2) of each marker by id, in marker sides.
        found: detections in the images of each set.
        degrees: degrees of the polynomials, by the set's name.
    """
    fits = []
    before = 0
    for name, images in found.items():
        for number, of_image in enumerate(images, start=before):
            for detector, seen in of_image.items():
                fit = fit_board(corners, seen, degrees[name])
                if fit is not None:
                    fits.append(Fitted(name, number, detector, fit))
        before += len(images)
    return fits


def choose_degrees(corners: dict[int, Array], found: ImagesOfSets) -> dict[str, int]:
    """Return the lowest degree for each set above which the errors barely decrease.

    For each degree, fits are made and the board's errors are estimated. The robust standard deviations σ of
    each detector's standardised residuals are combined as (Σ 1 / σ²)^-1/2, which favours accurate detectors.
    Unnecessary terms do not change it, while unmodelled distortion increases it. The lowest degree within
    `TOLERANCE` of the least is returned; without any fit, the lowest of all.
    """
    scores: dict[str, list[float]] = {name: [] for name in found}
    images = sum(len(of_set) for of_set in found.values())
    for degree in DEGREES:
        fits = fit_images(corners, found, dict.fromkeys(found, degree))
        learned = learn_board_errors(fits, len(corners), images) if fits else None
        residuals: dict[tuple[str, str], list[Array]] = {}
        for one in fits:
            assert learned is not None
            standardised = one.fit.standardised(learned.without[one.image])[one.fit.fitted]
            residuals.setdefault((one.set_name, one.detector), []).append(standardised.ravel())
        for name, of_set in scores.items():
            spreads = [robust_sigma(np.concatenate(v)) for (s, _), v in residuals.items() if s == name]
            known = [spread for spread in spreads if spread > 0]
            of_set.append(float(np.sum(np.power(known, -2.0)) ** -0.5) if known else float("inf"))
    return {
        name: next(
            d for d, score in zip(DEGREES, of_set, strict=True) if score <= min(of_set) * (1 + TOLERANCE)
        )
        for name, of_set in scores.items()
    }
