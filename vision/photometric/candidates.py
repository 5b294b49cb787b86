"""Candidates: quadrilaterals that resemble a marker, one for each place and id, outside known markers."""

from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from skyherd.geometry import Array, BoolArray, ComplexArray, IntArray, to_complex
from skyherd.markers.dictionary import cells_per_side
from skyherd.vision.grey import Image
from skyherd.vision.photometric.evidence.likelihood import MarkerOdds, no_odds
from skyherd.vision.photometric.fitting.fit_result import FitResults, no_fit_results
from skyherd.vision.photometric.fitting.local_homography import LocalHomographies
from skyherd.vision.photometric.fitting.plane import Plane
from skyherd.vision.photometric.refine import START_SIGMA_PX
from skyherd.vision.photometric.state import CameraState
from skyherd.vision.row_record import RowRecord
from skyherd.vision.search.decode import MIN_CORRELATION, DecodedQuads, decode_quads, no_decoded_quads
from skyherd.vision.search.edges import EdgeFits, fit_edges

PALE_SHARE = 0.3
"""While markers are known in an image, candidates whose cells show less than this share of the camera's usual
print contrast are not fitted. Measured: markers of 8 to 30 px at noise up to 10 show 0.79 or more, those that
are blurred three times as much as the others 0.36. Of the dark patches of ground that resemble markers 95 %
show 0.29 or less; they took a quarter of the detector's time in missions."""

CLEAR_CORRELATION = 0.8
"""Correlation of a quadrilateral's cells with a marker's from which on it is a candidate. Chosen: most
outlines of markers on photographs have 0.95, and what is no marker hardly ever has 0.8."""

DOUBTFUL_CORRELATION, EDGE_CORRELATION = 0.4, 0.75
"""Quadrilaterals that have the first are read again at their edges, and are candidates if they have the
second there. Outlines that are off are thus found, and what merely resembles a marker costs no fit.

Measured on 5,400 markers of 36h11 (`benchmarks/touching.py --tuning`): 4,214 are found, and 4,199 if those of
the fallback need 0.8 at their edges. Under odd conditions (tuning seeds) 3,894 of 4,032 are found: one more
than if those of the first search need 0.6 as they are, and two more than with 0.8 at their edges. On
photographs that search has 2,836 candidates instead of 6,055."""

BORDER_PX = 4.0
"""Quadrilaterals with a corner nearer to the image's border may be the rest of a marker, whose edges lie
outside. Derived: a pixel of the smallest image that is searched."""

CORNER_ANISOTROPY_ERROR_PX = 1.0
"""Accuracy of an anisotropy that is computed from a quadrilateral's corners, px. Chosen: corners are found to
about a pixel. Within it, the plane's anisotropy is the better start."""

MIN_CUT_ANISOTROPY, MAX_CUT_SKEW = 0.15, 0.3
"""Anisotropy from which on a marker may be a part of a larger one, and largest share of it off the marker's
own axes. Chosen: half of a marker has 0.33, all along its sides, and markers seen at 40 degrees have 0.13.
Measured on 7,200 markers of 4X4_50 that the border cuts: 26 halves pass for marker 17, with 0.33."""

MIN_DIVISOR_PX = 1e-6
"""Smallest side that is divided by, px. Chosen far below that of any marker."""


@dataclass(frozen=True)
class Weighed(RowRecord):
    """Evidence for the M candidates that the first fit does not verify.

    Attributes:
        rows: (M,) their numbers among all candidates.
        edges: of them, with corners in the order of the decoded marker.
        odds: of the likeliest marker of each.
    """

    rows: IntArray
    edges: EdgeFits
    odds: MarkerOdds

    @property
    def corners_px(self) -> Array:
        """Corners (M, 4, 2) by their edges, px, in the order of the likeliest marker."""
        return self.edges.turned(self.odds.turns).corners_px


@cache
def nothing_weighed() -> Weighed:
    """Return the record with M = 0."""
    none, empty = np.zeros(0, dtype=np.int64), np.zeros(0)
    edges = EdgeFits(np.zeros((0, 4, 2)), empty, empty, np.zeros((0, 3)), empty)
    return Weighed(none, edges, no_odds(none))


@dataclass(frozen=True)
class SearchPass:
    """Result of one search of an image.

    Attributes:
        quads_px: (Q, 4, 2) corners of the quadrilaterals that were found outside known markers, px.
        decoded: those that may resemble a marker, several of one place.
        candidates: the N of `decoded` that are fitted, after non-maximum suppression.
        fits: of the N candidates, in their order.
        good: (N,) whether each is accepted as a marker, after non-maximum suppression.
        plane: common plane of the markers, as far as it is known afterwards.
        weighed: evidence for those that the first fit does not verify.
        parts: (N,) whether each is refused only as it may be the part of a cut marker.
    """

    quads_px: Array
    decoded: DecodedQuads
    candidates: DecodedQuads
    fits: FitResults
    good: BoolArray
    plane: Plane
    weighed: Weighed
    parts: BoolArray

    @property
    def found(self) -> FitResults:
        """Return the accepted markers."""
        return self.fits.take(self.good)

    @classmethod
    def empty(cls, dictionary: str, plane: Plane, quads_px: Array) -> "SearchPass":
        """Return a search without candidates; `dictionary` is that of the markers."""
        quads, fits, none = no_decoded_quads(), no_fit_results(dictionary), np.zeros(0, dtype=bool)
        return cls(quads_px, quads, quads, fits, none, plane, nothing_weighed(), none)

    def joined(self, other: "SearchPass") -> "SearchPass":
        """Return the results of this search followed by those of another, with the other's plane."""
        later = replace(other.weighed, rows=other.weighed.rows + self.good.size)
        return SearchPass(
            np.concatenate([self.quads_px, other.quads_px]),
            self.decoded.joined(other.decoded),
            self.candidates.joined(other.candidates),
            self.fits.joined(other.fits),
            np.concatenate([self.good, other.good]),
            other.plane,
            self.weighed.joined(later),
            np.concatenate([self.parts, other.parts]),
        )


def find_candidates(
    image: Image, dictionary: str, state: CameraState, quads_px: Array, *, beside_markers: bool
) -> DecodedQuads:
    """Return the quadrilaterals that resemble a marker, the best one of each place and id.

    The arguments are those of `decode_outlines` and `best_of_decoded`.
    """
    decoded = decode_outlines(image, dictionary, state, quads_px)
    return best_of_decoded(image, dictionary, state, decoded, beside_markers=beside_markers)


def decode_outlines(image: Image, dictionary: str, state: CameraState, quads_px: Array) -> DecodedQuads:
    """Return the quadrilaterals that may resemble a marker.

    Args:
        image: grey, (height, width).
        dictionary: of the markers.
        state: of the camera.
        quads_px: (Q, 4, 2) corners, px, clockwise as seen, beginning with any of the four.
    """
    return decode_quads(image, quads_px, dictionary, _sigma_px(state), DOUBTFUL_CORRELATION)


def best_of_decoded(
    image: Image,
    dictionary: str,
    state: CameraState,
    decoded: DecodedQuads,
    *,
    beside_markers: bool,
    keep_at_border: bool = True,
) -> DecodedQuads:
    """Return the candidates among decoded quadrilaterals, the best one of each place and id.

    Doubtful ones are read again at their edges, and have the corners that these show.

    Args:
        image: grey, (height, width).
        dictionary: of the markers.
        state: of the camera.
        decoded: the quadrilaterals.
        beside_markers: whether other markers of the image are known; pale candidates are left out then.
        keep_at_border: whether doubtful ones at the image's border are candidates as they are.
    """
    is_clear = decoded.correlations >= CLEAR_CORRELATION
    doubtful = decoded.take(~is_clear)
    edges_px = fit_edges(image, doubtful.corners_px, cells_per_side(dictionary)).corners_px
    found = decoded.take(is_clear)
    found = found.joined(decode_quads(image, edges_px, dictionary, _sigma_px(state), EDGE_CORRELATION))
    if keep_at_border:
        is_alike = doubtful.correlations >= MIN_CORRELATION
        found = found.joined(doubtful.take(is_alike & _are_at_border(image, doubtful.corners_px)))
    if beside_markers and state.print_contrast is not None:
        found = found.take(found.print_contrasts >= PALE_SHARE * state.print_contrast)
    start = LocalHomographies.of_corners(found.corners_px)
    return found.take(non_maximum_suppression(found.ids, start.centers, start.sides_px(), found.correlations))


def _sigma_px(state: CameraState) -> float:
    """Return the blur that outlines are decoded under, px."""
    return state.sigma_px or START_SIGMA_PX


def _are_at_border(image: Image, corners_px: Array) -> BoolArray:
    """Return which quadrilaterals (N, 4, 2) have a corner within `BORDER_PX` of the image's border."""
    last_px = np.array(image.shape[::-1]) - 1
    return np.asarray((np.minimum(corners_px, last_px - corners_px) < BORDER_PX).any(axis=(1, 2)))


def outside_markers(quads_px: Array, known: LocalHomographies) -> BoolArray:
    """Return which quadrilaterals (N, 4, 2) have their centre within no known marker."""
    middles = to_complex(quads_px).mean(axis=1)
    distance = np.abs(middles[:, None] - known.centers)
    return np.asarray((distance > known.sides_px() / 2).all(axis=1))


def overlaps(center: complex, side_px: float, centers: ComplexArray, sides_px: Array) -> BoolArray:
    """Return which of N squares (N,) one square overlaps.

    Two overlap if their centres are less than half the shorter one's side apart. Both boundaries of a
    marker's border do, and one region before and after erosion.
    """
    return np.asarray(np.abs(centers - center) < np.minimum(sides_px, side_px) / 2)


def non_maximum_suppression(
    ids: IntArray, centers: ComplexArray, sides_px: Array, merits: Array
) -> BoolArray:
    """Return the mask (N,) kept by non-maximum suppression among overlapping detections of one id.

    The one of greater merit is kept. Memory grows with N, not with its square: a page of text has thousands
    of candidates.
    """
    kept = np.ones(ids.size, dtype=bool)
    order = np.lexsort((-merits, ids))
    for rows in np.split(order, np.flatnonzero(np.diff(ids[order])) + 1):
        while rows.size > 1:
            best, rows = rows[0], rows[1:]
            is_rival = overlaps(centers[best], sides_px[best], centers[rows], sides_px[rows])
            kept[rows[is_rival]] = False
            rows = rows[~is_rival]
    return kept


def within_better(
    ids: IntArray, centers: ComplexArray, sides_px: Array, is_photometric: BoolArray
) -> BoolArray:
    """Return which of N markers (N,) have their centre within a better one.

    Photometric markers are better than others, and of two of different ids the larger one: a part of a marker
    can be the perfect image of a smaller marker.
    """
    merits = np.where(is_photometric, sides_px, 0.0)
    apart = np.abs(centers[:, None] - centers)
    is_other = (ids[:, None] != ids) | ~is_photometric[:, None]
    is_worse = (merits[:, None] < merits) & is_other
    return np.asarray(((apart < sides_px / 2) & is_worse).any(axis=1))


def may_be_cut(homographies: LocalHomographies, plane: Plane, size_px: tuple[int, int]) -> BoolArray:
    """Return which markers (N,) may be a part of a larger one, whose rest is beyond the image's border.

    Half of a marker that the border cuts can be the perfect image of another one, seen at 60 degrees. A
    marker may be such a part if it is narrower than its plane makes it, and the square over its longer side
    reaches beyond the image.

    Args:
        homographies: of the markers.
        plane: that they lie on; where none is shared, it counts as parallel to the image.
        size_px: width and height of the image.
    """
    width, height = size_px
    middle, m = complex(width - 1, height - 1) / 2, homographies.similarities
    plane = plane if plane.shared else Plane()
    narrower = homographies.anisotropies - plane.anisotropies(homographies.centers - middle) * m.conj()
    narrower *= m.conj()
    is_part = np.abs(narrower) > MIN_CUT_ANISOTROPY * np.abs(m) ** 2
    is_part &= np.abs(narrower.imag) < MAX_CUT_SKEW * np.abs(narrower.real)
    right, down = m + homographies.anisotropies, 1j * (m - homographies.anisotropies)
    longer, shorter = (np.where(narrower.real > 0, *pair) for pair in ((right, down), (down, right)))
    beyond = (np.abs(longer) / np.maximum(np.abs(shorter), MIN_DIVISOR_PX) - 0.5) * shorter
    steps = [side * beyond + end * longer for side in (-1, 1) for end in (-0.5, 0.5)]
    corners = homographies.centers + np.stack(steps)
    inside = (corners.real >= 0) & (corners.real < width) & (corners.imag >= 0) & (corners.imag < height)
    return np.asarray(is_part & ~inside.all(axis=0))


def unambiguous(fits: FitResults) -> FitResults:
    """Return the fits whose id was found once, in ascending order of id."""
    _, first, counts = np.unique(fits.ids, return_index=True, return_counts=True)
    return fits.take(first[counts == 1])


def on_plane(homographies: LocalHomographies, plane: Plane, middle: complex) -> LocalHomographies:
    """Return homographies with the plane's anisotropies, where their own agree within corners' accuracy."""
    anisotropies = plane.anisotropies(homographies.centers - middle) * homographies.similarities.conj()
    near = np.abs(anisotropies - homographies.anisotropies) < CORNER_ANISOTROPY_ERROR_PX
    return replace(homographies, anisotropies=np.where(near, anisotropies, homographies.anisotropies))
