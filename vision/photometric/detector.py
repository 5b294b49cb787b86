"""The photometric detector: markers measured at the Cramér-Rao bound, and followed between images.

Each image passes through these stages. Stages return values; the detector alone writes a camera's state.

1. *Follow* (`following`): markers of the last image are fitted where they are predicted. If all
   of them are found as usual, one compiled call has done this, verified them and learned the next state.
2. *Search* (`skyherd.vision.search`, `candidates`): the image is searched for dark quadrilaterals whose cells
   resemble a marker, in every fifth image, and at once when a followed marker is missing or none is known.
   A fallback search looks again where none was found: at twice the size, with stretched contrast, and
   without lines that cross outlines.
3. *Measure* (`measure`): the pattern of each candidate is fitted to the image's own pixels (`fitting.fit`,
   `refine`) and verified by its residuals (`verify`). A candidate that no fit explains is decided by its
   likelihood (`evidence`) and measured by a robust fit or its edges.
4. *Learn* (`state`): the camera's blur, noise, print, plane and tracks are where the next image begins.
"""

from dataclasses import replace

import numpy as np

from skyherd.errors import InputError
from skyherd.geometry import SQUARE_CORNERS, Array, to_points
from skyherd.markers.dictionary import code_distance
from skyherd.messages import Detections, Quality
from skyherd.vision.grey import Image, check_grey
from skyherd.vision.photometric.candidates import (
    SearchPass,
    best_of_decoded,
    decode_outlines,
    outside_markers,
    unambiguous,
)
from skyherd.vision.photometric.fitting.common_unknowns import OWN_PLANES
from skyherd.vision.photometric.fitting.fit_result import FitResults, no_fit_results
from skyherd.vision.photometric.fitting.local_homography import LocalHomographies
from skyherd.vision.photometric.fitting.plane import MIN_MARKERS_ON_PLANE, Plane
from skyherd.vision.photometric.following import fit_predicted, follow
from skyherd.vision.photometric.image_noise import image_noise
from skyherd.vision.photometric.likely import are_likely
from skyherd.vision.photometric.measure import measure_candidates
from skyherd.vision.photometric.refine import with_usual_blur
from skyherd.vision.photometric.state import CameraState
from skyherd.vision.photometric.tracks import ShownMarkers
from skyherd.vision.photometric.verify import verified
from skyherd.vision.search.crossed import find_crossed_quads
from skyherd.vision.search.faint import find_faint_quads
from skyherd.vision.search.quads import find_quads, find_small_quads

SEARCH_INTERVAL = 5
"""While all markers are followed, every image of this number is searched whole. Chosen: a new marker waits
this long at most. Measured on `star`: a search takes 4 ms and following 4.4, so that searches add a fifth;
in every image they would double the time."""

GROUND_INTERVAL = 5
"""While all markers are followed, every image of this number is tested for ground around a marker that is no
longer white (`cards`). Chosen: `SEARCH_INTERVAL`, so that a search and this fall on one image."""

FALLBACK_INTERVAL, FALLBACK_AFTER_SUCCESS = 10, 2
"""While all markers are followed, every search of the first number has a fallback if the last fallback found
nothing, and of the second number if it did. Chosen: it takes 45 ms of a core where the search takes 4, and
finds small or blurred markers. One that it alone can find waits 50 images at most. So does a small one
beside markers that are followed, around which the other searches do not look."""

MIN_FOLLOWED_SHARE = 0.6
"""Smallest share of the followed markers whose places are believed. Chosen: below it the image is taken for
that of another place or camera, and is searched as if nothing were known but blur and noise."""

FAINT_SHARE = 0.025
"""While all markers are followed, searches look only where dark pixels crowd by this share of the contrast of
the camera's markers. Chosen: a third of what markers of 9 px have, so that one in shade is still found;
ground with texture has 0.01 of the contrast of usual prints, and otherwise all of it is searched."""

LOOK_AROUND_INTERVAL = 10
"""A `DeferringDetector` searches one of this number of images whole, by parts. Chosen: the machine of a live
unit has other things to do while it waits for the next image."""

PARTS = 2
"""Parts of that search: the quadrilaterals of the search, and those at twice the size."""


class PhotometricDetector:
    """Finds, fits, verifies and follows markers; implements `skyherd.vision.Detector`.

    Positions have covariances that hold for the image at hand: residuals, not tables, give the noise.

    Args:
        dictionary: of the markers, such as `4X4_50`.
        following: whether markers are followed from one image of a unit to the next. If not, the result does
            not depend on earlier images.
        repeats: whether an id that is found at several places is reported at each of them. If not, it is left
            out. Markers are followed by their ids, so that following excludes this.
        thorough: whether the fallback looks again for small, faint and crossed markers. It takes more than
            half of the time.

    Attributes:
        states: state of each camera, by unit id.

    Raises:
        InputError: there is no such dictionary, or repeats are to be followed.
    """

    def __init__(
        self,
        dictionary: str = "4X4_50",
        *,
        following: bool = True,
        repeats: bool = False,
        thorough: bool = True,
    ) -> None:
        if following and repeats:
            raise InputError("detector", "markers cannot be followed whose ids repeat", "one of the two")
        self.dictionary, self.following, self.repeats = dictionary, following, repeats
        self.thorough = thorough
        self.states: dict[int, CameraState] = {}
        self._none = no_fit_results(dictionary)

    def detect(self, image: Image, *, time_s: float = 0.0, unit_id: int = 0) -> Detections:
        """Return the markers in a grey image (height, width) of 8 bits, in ascending order of id.

        Args:
            image: grey, (height, width), uint8.
            time_s: when it was taken; times that do not increase count as 1 s apart.
            unit_id: the unit whose image it is; each unit has its own state.

        Raises:
            InputError: the image is not a grey one of 8 bits, or is empty.
        """
        image = check_grey(image)
        state = self.states.get(unit_id, CameraState()) if self.following else CameraState()
        first = fit_predicted(image, self.dictionary, state, time_s)
        unsearched = state.unsearched + 1
        if first.is_usual and not self._is_due(unsearched) and unsearched % GROUND_INTERVAL:
            self.states[unit_id] = first.learned(state)
            return first.detections(image, state, time_s, unit_id)
        followed = follow(image, self.dictionary, state, first)
        found = followed.found
        if followed.is_missing and len(found.ids) < MIN_FOLLOWED_SHARE * len(state.tracks.seen.ids):
            followed, found = replace(followed, plane=Plane()), self._none
        state = replace(state, plane=followed.plane, unsearched=unsearched)
        is_amiss = followed.is_missing or not len(found.ids)
        if is_amiss or self._is_due(state.unsearched):
            state, searched = self._search(image, state, found.homographies, thoroughly=is_amiss)
            found = self._joined(found, searched)
        state = state.learned(found, state.plane, time_s)
        self.states[unit_id] = state
        return _detections(found, state.ratios.factors(), image, time_s, unit_id)

    def searches(self, image: Image) -> tuple[SearchPass, SearchPass]:
        """Return both searches of a whole image without memory: the first one, and the fallback.

        Nothing is learned; `detections_of` returns what both found.

        Raises:
            InputError: the image is not a grey one of 8 bits, or is empty.
        """
        return self._search_with_fallback(check_grey(image), CameraState(), self._none.homographies)

    def detections_of(
        self, image: Image, searches: tuple[SearchPass, SearchPass], *, time_s: float = 0.0, unit_id: int = 0
    ) -> Detections:
        """Return the markers that the `searches` of an image found, as `detect` does without memory."""
        found, state = self._joined(*(one.found for one in searches)), CameraState()
        state = state.learned(found, searches[1].plane, time_s)
        return _detections(found, state.ratios.factors(), image, time_s, unit_id)

    def measured(self, image: Image, quads_px: Array) -> Detections:
        """Return the markers among given dark quadrilaterals of an image, without a search and memory.

        Args:
            image: grey, (height, width), uint8.
            quads_px: (N, 4, 2) corners, px, clockwise as seen, beginning with any of the four.
        """
        image, state = check_grey(image), CameraState()
        found = self._measured(image, state, quads_px, self._none.homographies, keep_at_border=False).found
        return _detections(self._joined(found, self._none), state.ratios.factors(), image, 0.0, 0)

    def _is_due(self, unsearched: int) -> bool:
        """Return whether the whole image is searched though all known markers were found.

        `unsearched` is the number of images since the last search, with this one.
        """
        return unsearched >= SEARCH_INTERVAL

    def _joined(self, one: FitResults, other: FitResults) -> FitResults:
        """Return both in ascending order of id; an id at several places only if they are to be reported."""
        found = one.joined(other)
        return found.take(np.argsort(found.ids, kind="stable")) if self.repeats else unambiguous(found)

    def _search(
        self, image: Image, state: CameraState, followed: LocalHomographies, *, thoroughly: bool
    ) -> tuple[CameraState, FitResults]:
        """Return the state, and the markers anywhere in the image but where markers are followed.

        Unless it is to be done thoroughly, the fallback may be left out.
        """
        state = replace(state, searches=state.searches + 1, unsearched=0, parts=0)
        interval = FALLBACK_AFTER_SUCCESS if state.is_fallback_useful else FALLBACK_INTERVAL
        if not thoroughly and state.searches < interval:
            min_darkness = FAINT_SHARE * (state.contrast or 0.0)
            quads = find_quads(image, to_points(followed.images(SQUARE_CORNERS)), min_darkness)
            one = self._measured(image, state, quads, followed)
            return replace(state, plane=one.plane), one.found
        first, second = self._search_with_fallback(image, state, followed)
        state = replace(state, plane=second.plane, searches=0, is_fallback_useful=bool(second.good.any()))
        return state, first.found.joined(second.found)

    def _search_with_fallback(
        self, image: Image, state: CameraState, followed: LocalHomographies
    ) -> tuple[SearchPass, SearchPass]:
        """Return the search of a whole image, and the fallback search where the first finds nothing.

        Verified markers of the fallback must be printed like those of the first search, or be markers beyond
        doubt. They do not change the plane that these lie on.
        """
        first = self._measured(image, state, find_quads(image), followed)
        if not self.thorough:
            return first, SearchPass.empty(self.dictionary, first.plane, np.zeros((0, 4, 2)))
        found = first.found
        known = followed.joined(found.homographies)
        known_px = to_points(known.images(SQUARE_CORNERS))
        noise = image_noise(image)
        faint = find_faint_quads(image, known_px, noise)
        crossed = find_crossed_quads(image, known_px)
        quads = np.concatenate([find_small_quads(image, known_px), faint, crossed])
        second = self._measured(image, replace(state, plane=first.plane), quads, known, keep_at_border=False)
        if not (first.good.any() and second.good.any()):
            return first, second
        alike = verified(found.joined(second.found), noise, code_distance(self.dictionary))[found.ids.size :]
        alike |= second.found.qualities < Quality.PHOTOMETRIC
        if not alike.all():
            alike[~alike] = are_likely(image, self.dictionary, second.found.take(~alike))
        good = second.good.copy()
        good[good] = alike
        return first, replace(second, good=good, plane=first.plane)

    def _measured(
        self,
        image: Image,
        state: CameraState,
        quads_px: Array,
        known: LocalHomographies,
        *,
        keep_at_border: bool = True,
    ) -> SearchPass:
        """Return quadrilaterals outside of known markers, decoded and measured.

        Enough known markers show the plane. It is then not that of the others alone.
        """
        quads_px = quads_px[outside_markers(quads_px, known)]
        decoded = decode_outlines(image, self.dictionary, state, quads_px)
        candidates = best_of_decoded(
            image,
            self.dictionary,
            state,
            decoded,
            beside_markers=len(known) > 0,
            keep_at_border=keep_at_border,
        )
        given, sides_px = (image, self.dictionary, state, quads_px, candidates), known.sides_px()
        if len(known) < MIN_MARKERS_ON_PLANE:
            return replace(measure_candidates(*given, OWN_PLANES, sides_px), decoded=decoded)
        measured = measure_candidates(*given, state.plane, sides_px)
        return replace(measured, plane=state.plane, decoded=decoded)


class DeferringDetector(PhotometricDetector):
    """Follows markers as `PhotometricDetector` does, and leaves most searches to `look_around`.

    Followed markers are found in a few milliseconds, while the search of a whole image for new ones takes ten
    times as long. Here it is done after the image's detections were used, by parts, one after each image. A
    new marker is reported from the next image on. `detect` searches the whole image at once only when no
    marker is known or a followed one is missing. Without calls of `look_around`, new markers are found only
    when another one is lost.

    Args:
        dictionary: of the markers, such as `4X4_50`.
    """

    def __init__(self, dictionary: str = "4X4_50") -> None:
        super().__init__(dictionary, following=True)

    def look_around(self, image: Image, *, unit_id: int = 0) -> None:
        """Search the image that was last given to `detect` for markers that are not followed, if it is time.

        From the ninth image on, one part of `PARTS` is searched in each call, and nine images after the last
        one the first again. New markers are followed from now on.
        An id that is followed elsewhere already is followed no more, since it is at two places.

        Args:
            image: grey, (height, width), uint8.
            unit_id: the unit whose image it is.

        Raises:
            InputError: the image is not a grey one of 8 bits, or is empty.
        """
        image, state = check_grey(image), self.states.get(unit_id)
        if state is None or state.unsearched <= LOOK_AROUND_INTERVAL - PARTS:
            return
        part = state.parts
        known = state.tracks.seen.homographies
        known_px = to_points(known.images(SQUARE_CORNERS))
        searched = self._measured(
            image, state, self._quads(part, image, known_px), known, keep_at_border=part == 0
        )
        found, state = searched.found, replace(state, plane=searched.plane)
        if found.ids.size:
            last_s = state.tracks.times_s.max(initial=0.0)
            shown = ShownMarkers(found.ids, found.homographies, with_usual_blur(found), found.surroundings)
            state = replace(state, tracks=state.tracks.with_others(last_s, shown))
        is_last = part == PARTS - 1
        self.states[unit_id] = replace(
            state, parts=0 if is_last else part + 1, unsearched=0 if is_last else state.unsearched
        )

    def _is_due(self, unsearched: int) -> bool:
        """Return False: `look_around` searches instead."""
        return False

    def _quads(self, part: int, image: Image, known_px: Array) -> Array:
        """Return the corners (N, 4, 2), px, of the quadrilaterals that a part of the search finds."""
        return find_quads(image) if part == 0 else find_small_quads(image, known_px)


def _detections(
    found: FitResults, variance_factors: Array, image: Image, time_s: float, unit_id: int
) -> Detections:
    """Return the detections of markers; photometric variances are scaled by two factors (2,)."""
    scales = np.where((found.qualities == Quality.PHOTOMETRIC)[:, None], np.sqrt(variance_factors), 1.0)
    scales = scales[:, [0, 0, 1]]
    return Detections(
        unit_id=unit_id,
        time_s=time_s,
        image_size_px=np.array([image.shape[1], image.shape[0]]),
        ids=found.ids,
        centers_px=to_points(found.homographies.centers),
        headings_rad=found.homographies.headings_rad(),
        sides_px=found.homographies.sides_px(),
        corners_px=found.corners_px,
        covariances=scales[:, :, None] * found.covariances * scales[:, None, :],
        qualities=found.qualities,
    )
