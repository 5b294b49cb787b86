"""Markers measured by a photometric fit: as well as the noise allows.

OpenCV finds and identifies; then the marker's known pattern is fitted to the pixels by inverse-compositional
least squares (Baker and Matthews 2004). In marker coordinates x, sampled on a fixed grid,

    I(W(x)) ≈ a A + b T + b (T_x d_x + T_y d_y + T_θ dθ + T_s ds + T_σ dσ) + g (1 - A),

with T the pattern under blur, A the card's coverage, and offset a, gain b, shift d, turn dθ, log scale ds,
log blur dσ and ground level g unknown. The columns are the same in every iteration, so that one is a warp and
a matrix-vector product. The covariance is `σ_n² (JᵀJ)⁻¹` with the noise σ_n measured from the residual.
"""

from dataclasses import dataclass, replace
from functools import lru_cache

import cv2
import numpy as np
import numpy.typing as npt

from skyherd.geometry import Array
from skyherd.markers import cells_per_side, marker_cells
from skyherd.messages import Detections
from skyherd.optics import cell_edges, gather_with_derivatives, total_sigma_px
from skyherd.vision.aruco import ArucoDetector

SAMPLES_PER_PX = 1.4
SIZE_STEP, SIGMA_STEP = 1.05, 1.04
"""Patterns are kept for sides and blurs in these geometric progressions; the fit takes up the rest."""

EDGE_SIGMAS = 1.2
"""The grid ends this far inside the card, where texture of the ground no longer blurs in."""

ITERATIONS = 8
SETTLED_PX = 0.001
"""A fit is done once a step moves no sample by more than this."""

FARTHEST = 0.12
"""A fit that leaves OpenCV's centre by more than this, in marker sides, or its side, is given up."""

WORST_FIT = 0.8
"""Least share of the pixels' variance that the fitted pattern must explain."""

WORST_NOISE = 1.6
"""A fit whose residual is this many times the median of the image's markers is not of that marker."""

CUBIC_NOISE = 0.862
"""Standard deviation of unit white noise after OpenCV's cubic resampling, over all phases (a = -0.75)."""

START_PSF_PX = 0.8
BLUR_RATE = 0.2
BLUR_STEPS = 6


@dataclass(frozen=True)
class Pattern:
    """Template of one marker at one size and blur, ready to be fitted.

    Attributes:
        half: grid points from the centre to the edge of the grid.
        side_px: side of the marker the grid is made for.
        columns: (M, 8) J: coverage, pattern, its derivatives along right, down, turn, log scale, log
            blur, and the ground beyond the card.
        solver: (8, M) `(JᵀJ)⁻¹ Jᵀ`.
        inverse_normal: (8, 8) `(JᵀJ)⁻¹` for one sample a pixel.
    """

    half: int
    side_px: float
    columns: npt.NDArray[np.float32]
    solver: npt.NDArray[np.float32]
    inverse_normal: Array


@lru_cache(maxsize=512)
def make_pattern(dictionary: str, marker_id: int, size_bucket: int, sigma_bucket: int) -> Pattern:
    """Pattern for sides near `SIZE_STEP ** size_bucket` and blurs near `SIGMA_STEP ** sigma_bucket`, px."""
    side, sigma = SIZE_STEP**size_bucket, SIGMA_STEP**sigma_bucket
    edges = cell_edges(cells_per_side(dictionary), side)
    half = int((edges[-1] - EDGE_SIGMAS * sigma) * SAMPLES_PER_PX)
    x = np.arange(-half, half + 1) / SAMPLES_PER_PX
    e = gather_with_derivatives(x, edges, sigma)
    cells = np.pad(marker_cells(dictionary, marker_id).astype(float), 1, constant_values=1.0)
    rows, cover = e.value @ cells, e.value.sum(axis=1)
    along_right, along_down = rows @ e.slope.T, e.slope @ cells @ e.value.T
    right, down = x[None, :], x[:, None]
    columns = np.stack(
        [
            np.outer(cover, cover),
            rows @ e.value.T,
            along_right,
            along_down,
            right * along_down - down * along_right,
            right * along_right + down * along_down,
            sigma**2 * (rows @ e.curvature.T + e.curvature @ cells @ e.value.T),
            1.0 - np.outer(cover, cover),
        ],
        axis=-1,
    ).reshape(-1, 8)
    inverse = np.linalg.inv(columns.T @ columns)
    solver = np.ascontiguousarray(inverse @ columns.T, dtype=np.float32)
    return Pattern(half, side, columns.astype(np.float32), solver, inverse * SAMPLES_PER_PX**2)


@dataclass(frozen=True)
class Fit:
    """Pose of one marker as fitted: centre `u + iv`, heading, side; how it went, and its covariance.

    `log_blur` is by how much the blur found differs from the pattern's, `correlation` the share of the
    pixels' variance explained, `noise` the standard deviation of what is not, grey levels.
    """

    center_px: complex
    heading_rad: float
    side_px: float
    log_blur: float
    correlation: float
    noise: float
    covariance: Array


def fit_marker(
    image: npt.NDArray[np.uint8], pattern: Pattern, center_px: complex, heading_rad: float, side_px: float
) -> Fit:
    """Fit a pattern to an image, starting from a pose within a pixel or two of the truth."""
    width, first = 2 * pattern.half + 1, side_px
    for _ in range(ITERATIONS):
        # One grid step to the right of the marker, in image pixels: right is a quarter turn from heading.
        step = side_px / pattern.side_px / SAMPLES_PER_PX * 1j * np.exp(1j * heading_rad)
        corner = center_px - step * (1 + 1j) * pattern.half
        warp = np.array([[step.real, -step.imag, corner.real], [step.imag, step.real, corner.imag]])
        flags = cv2.INTER_CUBIC | cv2.WARP_INVERSE_MAP
        pixels = cv2.warpAffine(image, warp, (width, width), flags=flags, borderMode=cv2.BORDER_REPLICATE)
        samples = np.asarray(pixels, dtype=np.float32).ravel()
        solution = pattern.solver @ samples
        shift, turn, grow = -(solution[2] + 1j * solution[3]), -solution[4], -solution[5]
        gain = float(solution[1]) or 1.0
        center_px += complex(step * SAMPLES_PER_PX * shift / gain)
        heading_rad += float(turn / gain)
        side_px *= float(np.exp(np.clip(grow / gain, -0.2, 0.2)))
        moved = (abs(shift) + (abs(turn) + abs(grow)) * first / 2) / abs(gain)
        if moved < SETTLED_PX or not 0.5 < side_px / first < 2:
            break
    residual = samples - pattern.columns @ solution
    return _judge(pattern, samples, residual, solution, center_px, heading_rad, side_px)


def _judge(
    pattern: Pattern,
    samples: npt.NDArray[np.float32],
    residual: npt.NDArray[np.float32],
    solution: npt.NDArray[np.float32],
    center_px: complex,
    heading_rad: float,
    side_px: float,
) -> Fit:
    """The fit's covariance, from its own residual, in image axes."""
    gain = float(solution[1]) or 1.0
    noise = float(np.sqrt(residual @ residual / max(residual.size - 8, 1))) / CUBIC_NOISE
    marker_axes = noise**2 / gain**2 * pattern.inverse_normal[2:5, 2:5]
    scale = side_px / pattern.side_px
    c, s = np.cos(heading_rad), np.sin(heading_rad)
    turn = np.array([[-s * scale, -c * scale, 0.0], [c * scale, -s * scale, 0.0], [0.0, 0.0, 1.0]])
    return Fit(
        center_px=center_px,
        heading_rad=heading_rad,
        side_px=side_px,
        log_blur=float(solution[6]) / gain,
        correlation=float(1.0 - residual.var() / max(float(samples.var()), 1e-9)) if gain > 0 else -1.0,
        noise=noise,
        covariance=turn @ marker_axes @ turn.T,
    )


class PhotometricDetector:
    """OpenCV finds and identifies; a fit of each marker's pattern to the pixels measures it.

    The blur of each unit's camera is estimated from the fits and followed slowly. A fit that strays or does
    not look like the marker is given up for OpenCV's measurement.

    Attributes:
        blurs_px: standard deviation of lens and pixel together, as found for each unit.
    """

    def __init__(self, dictionary: str = "4X4_50") -> None:
        self.dictionary = dictionary
        self._finder = ArucoDetector(dictionary)
        self.blurs_px: dict[int, float] = {}

    def detect(self, image: npt.NDArray[np.uint8], *, time_s: float = 0.0, unit_id: int = 0) -> Detections:
        """Markers in a grey image (height, width) of 8 bits; raises as `ArucoDetector.detect`."""
        found = self._find(image, time_s=time_s, unit_id=unit_id)
        if not len(found):
            return found
        fits = self._fit_all(image, found)
        if unit_id not in self.blurs_px:
            self.blurs_px[unit_id] = total_sigma_px(START_PSF_PX)
            for _ in range(BLUR_STEPS):
                fits = self._fit_all(image, found)
                if abs(self._follow_blur(unit_id, fits, 1.0)) < np.log(SIGMA_STEP):
                    break
        self._follow_blur(unit_id, fits, BLUR_RATE)
        return _merge(found, fits)

    def _find(self, image: npt.NDArray[np.uint8], *, time_s: float, unit_id: int) -> Detections:
        return self._finder.detect(image, time_s=time_s, unit_id=unit_id)

    def _fit_all(self, image: npt.NDArray[np.uint8], found: Detections) -> list[Fit]:
        sigma_px = self.blurs_px.get(found.unit_id, total_sigma_px(START_PSF_PX))
        sigma_bucket = round(float(np.log(sigma_px) / np.log(SIGMA_STEP)))
        centers = found.centers_px[:, 0] + 1j * found.centers_px[:, 1]
        size_buckets = np.rint(np.log(found.sides_px) / np.log(SIZE_STEP)).astype(int)
        return [
            fit_marker(
                image,
                make_pattern(self.dictionary, int(marker_id), int(bucket), sigma_bucket),
                complex(center),
                float(heading),
                float(side),
            )
            for marker_id, bucket, center, heading, side in zip(
                found.ids, size_buckets, centers, found.headings_rad, found.sides_px, strict=True
            )
        ]

    def _follow_blur(self, unit_id: int, fits: list[Fit], rate: float) -> float:
        """Move a unit's blur towards what the fits found; returns the median step found."""
        steps = [fit.log_blur for fit in fits if fit.correlation > 0.9]
        step = float(np.clip(np.median(steps), -0.4, 0.4)) if steps else 0.0
        self.blurs_px[unit_id] = float(np.clip(self.blurs_px[unit_id] * np.exp(rate * step), 0.4, 4.0))
        return step


def _merge(found: Detections, fits: list[Fit]) -> Detections:
    """The fits where they can be trusted, what was found elsewhere."""
    centers = found.centers_px[:, 0] + 1j * found.centers_px[:, 1]
    fitted = np.array([fit.center_px for fit in fits])
    sides = np.array([fit.side_px for fit in fits])
    near = np.abs(fitted - centers) < FARTHEST * found.sides_px
    near &= np.abs(sides - found.sides_px) < FARTHEST * found.sides_px
    noise = np.array([fit.noise for fit in fits])
    good = near & (np.array([fit.correlation for fit in fits]) > WORST_FIT)
    good &= noise <= WORST_NOISE * np.median(noise)
    turn = np.array([fit.heading_rad for fit in fits]) - found.headings_rad
    grow = (sides / found.sides_px) * np.exp(1j * turn)
    corners = found.corners_px[..., 0] + 1j * found.corners_px[..., 1]
    moved = fitted[:, None] + (corners - centers[:, None]) * grow[:, None]
    return replace(
        found,
        centers_px=np.where(good[:, None], np.column_stack([fitted.real, fitted.imag]), found.centers_px),
        headings_rad=np.where(good, found.headings_rad + np.angle(grow), found.headings_rad),
        sides_px=np.where(good, sides, found.sides_px),
        corners_px=np.where(
            good[:, None, None], np.stack([moved.real, moved.imag], axis=-1), found.corners_px
        ),
        covariances=np.where(
            good[:, None, None], np.array([fit.covariance for fit in fits]), found.covariances
        ),
    )
