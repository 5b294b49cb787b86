"""Cramér–Rao bound of a marker's pose from its pixels.

Pixels under white Gaussian noise of standard deviation n carry the Fisher information

    F_kl = n⁻² Σ_pixels (∂I/∂θ_k) (∂I/∂θ_l),    cov(θ̂) ≥ F⁻¹

for every unbiased estimate. The unknowns θ of a marker are its pose (u, v, heading) and nuisance parameters:
log scale, gain, offset, log blur and the ground's grey level. Where the markers' plane is oblique, its two
affine and two projective parameters, shared by all markers of an image, are unknown too. The sum covers the
pixels of the card, marker and quiet zone.

Ground of unknown texture carries less information at the card's edge than the uniform ground assumed here.
The bound is then loose by some per cent, but remains a bound. Rounding noise of 8 bits, of variance 1/12,
must be added by the caller.

A displacement field w of the pattern, with the Gaussian of lens and pixel unchanged, changes the image by

    δI = -(w · ∇I + (Dw Σ) : ∇∇I),

Σ being the Gaussian's covariance; by the heat equation `∂I/∂ log σ = Σ : ∇∇I`. The image is that of
`skyherd.markers.blur_model` in the marker's own axes, where it is separable, with the blur at the marker's
centre. The sum over pixels is therefore taken on a grid along the marker's sides, each sample weighted by its
area in pixels.

Every unknown of the geometry is a generator of homographies, so that the marker's own motions and the plane's
tilt share one formula. The Schur complement eliminates the parameters that markers of an image share.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from skyherd.errors import InputError
from skyherd.geometry import Array, BoolArray, IntArray
from skyherd.markers.blur_model import cell_edges, gather_with_derivatives, total_sigma_px
from skyherd.markers.dictionary import marker_cells

SAMPLES_PER_PX = 1.0
"""Grid density along the marker's sides, samples per pixel. *Chosen*: blur is wider than a pixel, so that a
denser grid costs time and barely changes the bound."""

SIMILAR = 1e-6
"""Shear and perspective over a marker below which a homography counts as a similarity. *Chosen*: far above
rounding, and far below any visible effect; the plane then has no unknowns."""

N_POSE, N_OWN = 3, 8
"""Unknowns of one marker. *Derived* by counting: u, v and heading are its pose; with log scale, gain, offset,
log blur and ground level there are eight."""

_CARD = np.array([[0.0, -1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
"""From card coordinates (right, down) to marker coordinates (forward, left). *Derived*: forward is up on the
card."""

_MOVES = np.zeros((4, 3, 3))
_MOVES[0, 0, 2] = _MOVES[1, 1, 2] = 1.0
_MOVES[2, 1, 0], _MOVES[2, 0, 1] = 1.0, -1.0
_MOVES[3, 0, 0] = _MOVES[3, 1, 1] = 1.0
"""Generators (4, 3, 3) of a marker's shift right and down, its rotation and its log scale, on the card.
*Derived*: the derivatives of these homographies at the identity."""

_SLANTS = np.zeros((4, 3, 3))
_SLANTS[0, 0, 0], _SLANTS[0, 1, 1] = 1.0, -1.0
_SLANTS[1, 0, 1] = _SLANTS[1, 1, 0] = 1.0
_SLANTS[2, 2, 0] = _SLANTS[3, 2, 1] = 1.0
"""Generators (4, 3, 3) of the plane's two affine and two projective parameters, on the image. *Derived*
likewise."""


@dataclass(frozen=True)
class _Light:
    """Parameters of an image beside geometry: total blur of lens and pixel, and grey levels."""

    sigma_px: float
    black: float
    white: float
    ground: float


def pose_covariances(
    dictionary: str,
    ids: IntArray | Sequence[int],
    images_marker: Array,
    *,
    psf_px: float,
    noise: float,
    black: float = 30.0,
    white: float = 230.0,
    ground: float = 128.0,
    shared_plane: bool = True,
) -> Array:
    """Return the least covariance (N, 3, 3) of an unbiased estimate of (u px, v px, heading rad).

    Args:
        dictionary: dictionary of the markers, such as `4X4_50`.
        ids: (N,) markers of one image, whole and uncovered.
        images_marker: (N, 3, 3) homographies from marker coordinates (forward, left, in sides) to pixels.
        psf_px: standard deviation of the lens's blur.
        noise: standard deviation of the pixels' noise, grey levels.
        black: grey level of the marker's black.
        white: grey level of the card.
        ground: grey level of the ground around it.
        shared_plane: treat the plane of the markers as unknown, estimated from all of them together. It
            counts as known if every homography is a similarity.

    Raises:
        InputError: noise or blur is not positive, or the shapes do not match.
    """
    images_marker = np.asarray(images_marker, dtype=float)
    if images_marker.shape != (len(ids), 3, 3):
        raise InputError("images_marker", f"shape {images_marker.shape}", f"({len(ids)}, 3, 3)")
    if not (noise > 0 and psf_px > 0):
        raise InputError("bound", f"noise {noise}, psf_px {psf_px}", "both must be positive")
    if not len(ids):
        return np.zeros((0, 3, 3))
    images_card = images_marker @ _CARD
    light = _Light(sigma_px=total_sigma_px(psf_px), black=black, white=white, ground=ground)
    moves = np.broadcast_to(_MOVES, (len(ids), 4, 3, 3))
    if shared_plane and not all(_is_similarity(image_card) for image_card in images_card):
        moves = np.concatenate([moves, _slants_on_cards(images_card)], axis=1)
    information = noise**-2.0 * np.array(
        [
            _information(marker_cells(dictionary, int(marker_id)), image_card, move, light)
            for marker_id, image_card, move in zip(ids, images_card, moves, strict=True)
        ]
    )
    return _pose_covariances(information, _pose_derivatives(images_card, moves))


def sides_px(images_marker: Array) -> Array:
    """Return the sides (N,) of markers in the image, px: `sqrt |det J|`, J the Jacobian at the centre.

    `images_marker` (N, 3, 3) map marker coordinates, in sides, to pixels.
    """
    return np.asarray(np.sqrt(np.abs(np.linalg.det(_jacobians(images_marker)))))


def _jacobians(images_card: Array) -> Array:
    """Return J (N, 2, 2) at the origin of homographies (N, 3, 3)."""
    center = images_card[:, :2, 2] / images_card[:, 2:, 2]
    return np.asarray(
        (images_card[:, :2, :2] - center[:, :, None] * images_card[:, 2:, :2]) / images_card[:, 2:, 2:]
    )


def _is_similarity(image_card: Array) -> bool:
    jacobian = _jacobians(image_card[None])[0]
    metric = jacobian.T @ jacobian / abs(np.linalg.det(jacobian))
    bent = np.abs(image_card[2, :2] / image_card[2, 2]).max()
    return bool(np.abs(metric - np.eye(2)).max() < SIMILAR and bent < SIMILAR)


def _slants_on_cards(images_card: Array) -> Array:
    """Return the plane's generators in each card's frame (N, 4, 3, 3): `H⁻¹ V H`.

    V is taken about the markers' centroid and in units of their spread, for better conditioning.
    """
    centers = images_card[:, :2, 2] / images_card[:, 2:, 2]
    spread = max(float(centers.std()), float(sides_px(images_card).max()))
    middle = np.eye(3)
    middle[:2, 2], middle[2, 2] = -centers.mean(axis=0), spread
    slants = np.linalg.inv(middle) @ _SLANTS @ middle
    return np.asarray(np.linalg.inv(images_card)[:, None] @ slants @ images_card[:, None])


@dataclass(frozen=True)
class _Card:
    """A card on a grid along its sides, in units of the marker's side: grey levels and their derivatives."""

    x: Array
    y: Array
    covariance: Array
    image: Array
    cover: Array
    slope: tuple[Array, Array]
    bend: tuple[Array, Array, Array]

    def blurred(self, tensor: Array) -> Array:
        """Return `tensor : ∇∇I`."""
        xx, xy, yy = self.bend
        return np.asarray(tensor[0, 0] * xx + (tensor[0, 1] + tensor[1, 0]) * xy + tensor[1, 1] * yy)

    def moved(self, generator: Array) -> Array:
        """Return δI of the displacement field of a generator (3, 3) of homographies on the card."""
        wx, wy, wz = (g[0] * self.x + g[1] * self.y + g[2] for g in generator)
        shifted = (wx - wz * self.x) * self.slope[0] + (wy - wz * self.y) * self.slope[1]
        gradient = generator[:2, :2] - generator[2, 2] * np.eye(2)
        return np.asarray(-shifted - self.blurred(gradient @ self.covariance))


def _draw_card(cells: BoolArray, image_card: Array, light: _Light) -> _Card:
    """Draw the card under the blur at the marker's centre, taken as separable along its sides."""
    inverse = np.linalg.inv(_jacobians(image_card[None])[0])
    covariance = light.sigma_px**2 * inverse @ inverse.T
    sigmas = np.sqrt(np.diag(covariance))
    edges = cell_edges(cells.shape[0], 1.0)
    counts = np.maximum(np.rint(2 * edges[-1] * SAMPLES_PER_PX * light.sigma_px / sigmas), cells.shape[0])
    x, y = (edges[-1] * ((2 * np.arange(int(count)) + 1) / count - 1) for count in counts)
    along, down = (
        gather_with_derivatives(at, edges, sigma) for at, sigma in zip((x, y), sigmas, strict=True)
    )
    # Relative to the ground's level, so that the area beyond the card does not enter the derivatives.
    levels = np.where(cells, light.white, light.black) - light.ground
    levels = np.pad(levels, 1, constant_values=light.white - light.ground)
    value, slope, curvature = (rows @ levels for rows in (down.value, down.slope, down.curvature))
    return _Card(
        x=x[None, :],
        y=y[:, None],
        covariance=covariance,
        image=value @ along.value.T,
        cover=np.outer(down.value.sum(axis=1), along.value.sum(axis=1)),
        slope=(value @ along.slope.T, slope @ along.value.T),
        bend=(value @ along.curvature.T, slope @ along.slope.T, curvature @ along.value.T),
    )


def _information(cells: BoolArray, image_card: Array, moves: Array, light: _Light) -> Array:
    """Return the Fisher information (M + 4, M + 4) at unit noise: own motions, light, then the plane."""
    card = _draw_card(cells, image_card, light)
    lit = [card.image, card.cover, card.blurred(card.covariance), 1.0 - card.cover]
    moved = [card.moved(move) for move in moves]
    columns = np.stack([*moved[:4], *lit, *moved[4:]]).reshape(len(moves) + 4, -1)
    depth = image_card[2, 0] * card.x + image_card[2, 1] * card.y + image_card[2, 2]
    step = (card.x[0, 1] - card.x[0, 0]) * (card.y[1, 0] - card.y[0, 0])
    pixels = step * abs(np.linalg.det(image_card)) / np.abs(depth) ** 3
    return np.asarray((columns * pixels.ravel()) @ columns.T)


def _pose_derivatives(images_card: Array, moves: Array) -> Array:
    """Return derivatives (N, 3, M) of (u, v, heading) by motions (N, M, 3, 3): `δH = H W`."""
    changed = images_card[:, None] @ moves
    depth = images_card[:, None, 2:, 2]
    center = images_card[:, None, :2, 2] / depth
    forward = -(images_card[:, None, :2, 1] - center * images_card[:, None, 2:, 1]) / depth
    d_center = (changed[..., :2, 2] - center * changed[..., 2:, 2]) / depth
    d_forward = -(changed[..., :2, 1] - d_center * images_card[:, None, 2:, 1] - center * changed[..., 2:, 1])
    d_forward = (d_forward - forward * changed[..., 2:, 2]) / depth
    turn: Array = forward[..., 0] * d_forward[..., 1] - forward[..., 1] * d_forward[..., 0]
    heading = turn / (forward**2).sum(axis=-1)
    return np.stack([d_center[..., 0], d_center[..., 1], heading], axis=1)


def _pose_covariances(information: Array, derivatives: Array) -> Array:
    """Return the covariances (N, 3, 3) of the poses, with the plane eliminated by Schur complement."""
    own, cross = information[:, :N_OWN, :N_OWN], information[:, :N_OWN, N_OWN:]
    own_inverse = np.linalg.inv(own)
    by_own = np.zeros((len(own), N_POSE, N_OWN))
    by_own[:, :, :4] = derivatives[:, :, :4]
    covariances = by_own @ own_inverse @ by_own.transpose(0, 2, 1)
    if cross.shape[2]:
        plane = information[:, N_OWN:, N_OWN:]
        residual = (plane - cross.transpose(0, 2, 1) @ own_inverse @ cross).sum(axis=0)
        through = derivatives[:, :, 4:] - by_own @ own_inverse @ cross
        covariances = covariances + through @ np.linalg.inv(residual) @ through.transpose(0, 2, 1)
    return np.asarray((covariances + covariances.transpose(0, 2, 1)) / 2)
