"""Which markers decide on what all markers of an image share."""

from types import SimpleNamespace

import numpy as np
import pytest
from tests.helpers.design_matrix_reference import MIDDLE_GREY
from tests.helpers.fit_reference import print_inliers

from skyherd.vision.photometric.fitting.design_matrix import BLACK


def solution_of(shares):
    """Fits to 100 pixels each, white at 200 grey levels, of prints of these contrasts, shares of white."""
    contrasts = 200.0 * np.asarray(shares)
    values = np.zeros((contrasts.size, BLACK + 1))
    values[:, BLACK] = 200.0 - contrasts - MIDDLE_GREY
    return SimpleNamespace(
        values=values,
        contrasts=lambda: contrasts,
        noise_stds=lambda: np.full(contrasts.size, 5.0),
        pixels=np.full(contrasts.size, 100.0),
    )


@pytest.mark.parametrize(("share", "counts"), [(0.9, True), (0.56, True), (0.52, False), (0.1, False)])
def test_markers_of_low_print_contrast_are_not_evidence(share, counts):
    """0.54 of white, with three prints of 0.9: paler is ground that was taken for a marker."""
    solution = solution_of([0.9, 0.9, 0.9, share])
    assert print_inliers(solution, np.ones(4, dtype=bool)).tolist() == [True, True, True, counts]


def test_what_has_wrong_cells_decides_on_nothing_unless_all_have():
    solution = solution_of([0.9, 0.9, 0.9])
    assert print_inliers(solution, np.array([True, False, True])).tolist() == [True, False, True]
    assert print_inliers(solution, np.zeros(3, dtype=bool)).all()
