"""The columns of the photometric fit's linear model, pixel by pixel in double precision: slow and simple."""

from dataclasses import dataclass

import numpy as np
from scipy.special import ndtr

UNKNOWNS = (
    *("black", "contrast", "right", "down", "turn", "grow", "blur", "ground", "anisotropy_x", "anisotropy_y"),
    *("light_x", "light_y", "keystone_x", "keystone_y", "tone"),
)
"""Names of the model's columns, in their order; the pixels' own values follow."""


@dataclass(frozen=True)
class Drawn:
    """A blurred marker at points, with derivatives; each of the points' shape."""

    value: np.ndarray
    x: np.ndarray
    y: np.ndarray
    xx: np.ndarray
    xy: np.ndarray
    yy: np.ndarray


def draw(white, x, y, sigma):
    """Return T of a marker with white cells (n, n) at points x, y, in sides, as a sum over black cells."""
    n, black = len(white), ~white

    def gathered(along):
        z = (np.asarray(along, dtype=float)[..., None] - (np.arange(n + 1) / n - 0.5)) / sigma
        bell = np.exp(-z * z / 2) / np.sqrt(2 * np.pi) / sigma
        return [-np.diff(steps, axis=-1) for steps in (ndtr(z), bell, -z * bell / sigma)]

    across, down = gathered(x), gathered(y)

    def summed(of_x, of_y):
        return np.einsum("...r,rc,...c->...", down[of_y], black.astype(float), across[of_x])

    return Drawn(1 - summed(0, 0), *(-summed(*orders) for orders in ((1, 0), (0, 1), (2, 0), (1, 1), (0, 2))))


def columns_of(
    image, white, where, row, *, sigma, limit, ratio, half_card, texture, round_in_image, ground_level=None
):
    """Return the weighted columns (M, 16), places (M, 2) and pixels (M, 2) of marker `row` of `where`.

    Every pixel of the image is asked whether it is the marker's. `half_card` is None where no ground counts,
    and `ground_level` for a marker on a card.
    """
    m, k, h = where.similarities[row], where.anisotropies[row], where.perspectives[row]
    v, u = np.mgrid[: image.shape[0], : image.shape[1]]
    p = u + 1j * v - where.centers[row]
    near = 1 - (np.conj(h) * p).real
    with np.errstate(divide="ignore", invalid="ignore"):
        z = (np.conj(m) * p - k * np.conj(p)) / (abs(m) ** 2 - abs(k) ** 2) / near
        mine = (near > 0) & (np.abs(z.real) <= limit) & (np.abs(z.imag) <= limit)
    z, x, y = z[mine], z[mine].real, z[mine].imag
    drawn, frame, e = draw(white, x, y, sigma), draw(np.zeros_like(white), x, y, sigma), k / m

    def in_image(seen):
        value, log_blur = seen.value.copy(), sigma**2 * (seen.xx + seen.yy)
        if round_in_image:
            e_here = e / (1 + abs(e) ** 2) - h * np.conj(m) * z / 2
            value -= e_here.real * sigma**2 * (seen.xx - seen.yy) + e_here.imag * 2 * sigma**2 * seen.xy
            value += 1.5 * (np.conj(h) * m * z).real * log_blur
        return value, log_blur

    white_share, log_blur = in_image(drawn)
    level, ground = white_share, np.zeros(len(x))
    if ground_level is not None:
        ground, frame_blur = in_image(frame)
        level, log_blur = white_share + ground_level * ground, log_blur + ground_level * frame_blur
        drawn = Drawn(
            *(getattr(drawn, of) + ground_level * getattr(frame, of) for of in Drawn.__annotations__)
        )
    if half_card is not None:
        spread = np.sqrt(1 + abs(e) ** 2)
        covered = ndtr((half_card - np.abs(x)) * spread / (sigma * abs(1 - e)))
        covered *= ndtr((half_card - np.abs(y)) * spread / (sigma * abs(1 + e)))
        ground = 1 - covered
    # A step δz of the pose: the marker's point z is seen where z + δz was, so that T changes by -∇T · δz.
    slopes = drawn.x + 1j * drawn.y
    moved = [-(np.conj(slopes) * step).real for step in (1 + 0 * z, 1j + 0 * z, 1j * z, z)]
    anisotropic = [-(np.conj(slopes) * step).real for step in (np.conj(z), 1j * np.conj(z))]
    leant = [(np.conj(slopes) * z).real * along for along in (x, y)]
    lit = [along * (ratio + level) for along in (x, y)]
    columns = [np.ones(len(x)), white_share, *moved, log_blur, ground, *anisotropic, *lit, *leant]
    columns += [level * (1 - level), image[mine] - 128.0]
    weights = 1 / np.sqrt(1 + (texture * ground) ** 2)
    return np.stack(columns, axis=1) * weights[:, None], np.stack([x, y], 1), np.stack([v[mine], u[mine]], 1)
