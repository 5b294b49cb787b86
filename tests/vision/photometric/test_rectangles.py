"""Light rectangles in dark squares: the compiled choice is that of all rectangles, drawn one by one."""

import numpy as np
import pytest

from skyherd.errors import InputError
from skyherd.vision.native.library import library
from skyherd.vision.photometric.evidence.rectangles import MAX_RECTANGLES, _rectangles, _stretches

BLURS_CELLS = (0.3, 0.5)


@pytest.mark.parametrize("n_cells", [4, 6, 8])
def test_rectangles_kept_explain_most_of_all_that_are_drawn(n_cells) -> None:
    """Least squares of every rectangle beside a constant and the ground, to random readings."""
    drawn = _rectangles(n_cells, BLURS_CELLS, False)
    low, high = _stretches(len(drawn.along))
    along, down = drawn.along[low] - drawn.along[high], drawn.down[low] - drawn.down[high]
    basis = np.array(drawn.basis).reshape(2, -1)
    images = np.random.default_rng([1, n_cells]).normal(0, 1, (3, basis.shape[1]))
    images = images - images @ basis.T @ basis
    gains = []
    for stretch in down:  # all rectangles at once would take a gigabyte
        planes = np.multiply.outer(stretch, along).transpose(1, 0, 2).reshape(len(along), -1)
        planes = planes - planes @ basis.T @ basis
        gains.append(np.maximum(images @ planes.T, 0) ** 2 / np.square(planes).sum(axis=1))
    gains = np.concatenate(gains, axis=1)
    sums = drawn.down @ images.reshape(3, *drawn.ground.shape) @ drawn.along.T
    found = library().best_rectangles(np.ascontiguousarray(sums), drawn.unexplained, MAX_RECTANGLES)
    for own, those in zip(gains, found, strict=True):
        assert len(set(those.tolist())) == MAX_RECTANGLES
        np.testing.assert_allclose(np.sort(own[those]), np.sort(own)[-MAX_RECTANGLES:], rtol=1e-9)


def test_darker_rectangles_explain_nothing() -> None:
    """A square that is darker than its border: every rectangle would have a negative brightness."""
    drawn = _rectangles(6, BLURS_CELLS, False)
    square = -np.outer(drawn.down[0] - drawn.down[-1], drawn.along[0] - drawn.along[-1])
    sums = (drawn.down @ square @ drawn.along.T)[None]
    light = library().best_rectangles(-sums, drawn.unexplained, 1)
    dark = library().best_rectangles(sums, drawn.unexplained, 1)
    assert light.item() == len(drawn.along) - 3 + (len(drawn.along) - 3) * len(drawn.unexplained)
    assert dark.item() == 0, "the first one, since all explain nothing"


@pytest.mark.parametrize("edges", [2, 129])
def test_grid_of_too_few_or_too_many_edges_is_refused(edges) -> None:
    stretches = (edges - 1) * (edges - 2) // 2
    with pytest.raises(InputError):
        library().best_rectangles(np.zeros((1, edges, edges)), np.empty((stretches, stretches)), 1)
