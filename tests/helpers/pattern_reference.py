"""The fit of patterns to readings in NumPy: the reference for the compiled one."""

import numpy as np

from skyherd.vision.native.pattern_records import PARTS
from skyherd.vision.photometric.evidence import pattern_fit
from skyherd.vision.photometric.evidence.pattern_fit import PatternFits, columns_of, densities
from skyherd.vision.photometric.evidence.readings import MIN_CONTRAST, on_marker

SYMMETRIC = np.array([[0, 1, 2], [1, 3, 4], [2, 4, 5]])
"""Places of the products of (1, x, y) with (1, x, y) among the six different ones."""


def fit_patterns(readings, white, ground=None, *, any_contrast=False):
    """Return what the function of this name in `skyherd.vision.photometric.evidence.pattern_fit` does."""
    columns, on_card = columns_of(readings.n_cells), on_marker(readings.n_cells)
    y = readings.levels[:, None] / readings.scales[:, None, None]
    rounding = (pattern_fit.ROUNDING_STD / readings.scales)[:, None]
    seen, ground = readings.seen[:, None], None if ground is None else ground[:, None]
    share = np.broadcast_to(np.where(on_card, 1.0, pattern_fit.FIRST_ZONE_SHARE) * seen, white.shape)
    std = np.full(white.shape[:2], pattern_fit.FIRST_STD)
    usual, parts = pattern_fit.USUAL_STD, pattern_fit.USUAL_STD_PARTS
    for _ in range(pattern_fit.ITERATIONS):
        normal, right = _normal_equations(columns, share, white, y, ground)
        ridge = (std / pattern_fit.GRADIENT_STD) ** 2 * PARTS**2
        for column in range(6):
            normal[..., column, column] += ridge if column % 3 else pattern_fit.RIDGE
        levels = np.linalg.solve(normal, right[..., None])[..., 0]
        light, factor = levels[..., :3] @ columns.places.T, levels[..., 3:6] @ columns.places.T
        errors = y - light - white * factor - (0.0 if ground is None else levels[..., 6:] * ground)
        used = share[..., on_card]
        spread = (used * errors[..., on_card] ** 2).sum(axis=-1)
        std = np.sqrt((parts * usual**2 + spread) / (parts + used.sum(axis=-1)) + rounding**2)
        bell, density = densities(errors, std[..., None], columns.outlier_priors)
        share = seen * bell / density
    logs = readings.weights[:, None] * (seen * np.log(density)).sum(axis=-1)
    logs -= 0.5 * np.square(levels[..., [1, 2, 4, 5]] / pattern_fit.GRADIENT_STD).sum(axis=-1)
    grey = levels[..., [0, 3, 1, 2, 4, 5]] * readings.scales[:, None, None]
    if not any_contrast:
        short = np.log(np.maximum(grey[..., 1], MIN_CONTRAST) / readings.ranges[:, None])
        logs -= 0.5 * np.square(np.minimum(short, 0.0) / pattern_fit.LOG_CONTRAST_STD)
    logs = np.where(grey[..., 1] >= MIN_CONTRAST, logs, -np.inf)
    return PatternFits(logs, grey, std, 1 - share[..., on_card].mean(axis=-1))


def _normal_equations(columns, share, white, y, ground):
    """Return the weighted normal matrices (N, K, 6 or 7, ...) and right sides of b, g, h, c, p, q and d."""
    size = 6 if ground is None else 7
    normal, right = np.zeros((*white.shape[:2], size, size)), np.zeros((*white.shape[:2], size))
    shaded, places = share * white, columns.places
    _, x, down = places.T
    squares = np.column_stack([places, x * x, x * down, down * down])
    normal[..., :3, :3] = (share @ squares)[..., SYMMETRIC]
    normal[..., :3, 3:6] = normal[..., 3:6, :3] = (shaded @ squares)[..., SYMMETRIC]
    normal[..., 3:6, 3:6] = ((shaded * white) @ squares)[..., SYMMETRIC]
    right[..., :3], right[..., 3:6] = (share * y) @ places, (shaded * y) @ places
    if ground is not None:
        own = share * ground
        normal[..., 6, :3] = normal[..., :3, 6] = own @ places
        normal[..., 6, 3:6] = normal[..., 3:6, 6] = (own * white) @ places
        normal[..., 6, 6] = (own * ground).sum(axis=-1) + pattern_fit.RIDGE
        right[..., 6] = (own * y).sum(axis=-1)
    return normal, right
