"""The photometric detector: markers measured as precisely as the noise allows, and followed between images.

Each image passes through these stages.

1. *Follow* (`following`): markers of the unit's last image are fitted where they should be by now
   (`skyherd.vision.photometric.tracks`), and once more where the camera's motion has taken them if that is
   elsewhere (`skyherd.vision.photometric.common_motion`).
2. *Search*: the whole image is searched for dark quadrilaterals (`skyherd.vision.search`), in every fifth
   image, and at once when a followed marker is missing or none is known. Their cells are compared with all
   markers of the dictionary; what is much paler than the unit's other markers is refused, but nothing for a
   doubtful bit yet. Where no marker is found there is a second look (`skyherd.vision.search.second_look`),
   which also has what OpenCV's detector finds; less often while markers are followed and it finds nothing.
3. *Fit*: the known pattern of each marker is fitted to the image's own pixels (`fitting.fit`), under whatever
   blur it has (`unknown_blur`), a streak of motion too (`streaks`); large markers in a shrunk image.
4. *Verify*: a fit counts only if it shows its marker's bits and leaves little else (`acceptance`, `verify`).
   A marker that something seems to cover is fitted once more to its visible pixels (`fitting.occlusion`), and
   one that does not lie on the others' plane with a perspective of its own.
5. *Learn*: if markers are followed, the unit's blur, noise and plane are where the next image's fits begin.
"""

from functools import reduce

import numpy as np

from skyherd.errors import InputError
from skyherd.geometry import SQUARE_CORNERS, Array, to_points
from skyherd.messages import Detections
from skyherd.vision.grey import Image, check_grey
from skyherd.vision.photometric.fitting.fit_result import FitResults, no_fit_results
from skyherd.vision.photometric.fitting.local_homography import LocalHomographies
from skyherd.vision.photometric.following import follow
from skyherd.vision.photometric.image_estimates import ImageEstimates
from skyherd.vision.photometric.look import Look, look_at_candidates, look_at_quads, look_twice
from skyherd.vision.photometric.places import unambiguous
from skyherd.vision.search.decode import MIN_CORRELATION, DecodedQuads
from skyherd.vision.search.quads import find_quads

SEARCH_INTERVAL = 5
"""While all markers are followed, the whole image is searched in every image of this number. Chosen: a new
marker waits this long at most. Measured on `star`: a search takes 4 ms and following 4.4, so that searches
add a fifth; in every image they would double the time."""

SECOND_LOOK_INTERVAL, SECOND_LOOK_AFTER_SUCCESS = 10, 2
"""While all markers are followed there is a second look at every search of the first number if the last one
found nothing new, and of the second number if it did. Chosen: it takes 45 ms of a core where the first look
takes 4, and finds what is small or blurred, of which there is more where there was some; a marker that it
alone can find waits 50 images at most. So does a small one close beside markers that are followed, around
which the other searches do not look."""

FAINT_SHARE = 0.025
"""While all markers are followed, searches look only where dark pixels crowd by this share of the contrast of
the unit's markers. Chosen: a third of what markers of 9 px have, so that one in shade is still found; ground
with texture has 0.01 of the contrast of usual prints, and otherwise all of it is looked at."""


class PhotometricDetector:
    """Finds, fits, verifies and follows markers; implements `skyherd.vision.Detector`.

    Positions come with covariances that hold for the image at hand: residuals, not tables, give the noise.

    Args:
        dictionary: of the markers, such as `4X4_50`.
        following: whether markers are followed from one image of a unit to the next. If not, every image is
            taken by itself, and the result does not depend on earlier ones.
        repeats: whether an id that is found at several places is reported at each of them. If not, it is left
            out. Markers that are followed are followed by their ids, so that this is for images taken by
            themselves.

    Attributes:
        estimates: what was estimated of each unit's images, by unit id.

    Raises:
        InputError: there is no such dictionary, or repeats are to be followed.
    """

    def __init__(self, dictionary: str = "4X4_50", *, following: bool = True, repeats: bool = False) -> None:
        if following and repeats:
            raise InputError("detector", "markers cannot be followed whose ids repeat", "one of the two")
        self.dictionary, self.following, self.repeats = dictionary, following, repeats
        self.estimates: dict[int, ImageEstimates] = {}
        self._nothing = no_fit_results(dictionary)

    def detect(self, image: Image, *, time_s: float = 0.0, unit_id: int = 0) -> Detections:
        """Return the markers in a grey image (height, width) of 8 bits, in ascending order of id.

        Args:
            image: grey, (height, width), uint8.
            time_s: when it was taken; times that do not increase count as 1 s apart.
            unit_id: whose image it is; what is learned is kept for each unit apart.

        Raises:
            InputError: the image is not a grey one of 8 bits, or is empty.
        """
        image = check_grey(image)
        if unit_id not in self.estimates or not self.following:
            self.estimates[unit_id] = ImageEstimates()
        known = self.estimates[unit_id]
        found, lost = follow(image, self.dictionary, known, time_s)
        known.unsearched += 1
        is_amiss = lost or not len(found.ids)
        if is_amiss or self._is_due(known):
            found = found.joined(self._search(image, known, found.homographies, thoroughly=is_amiss))
            found = found.take(np.argsort(found.ids, kind="stable")) if self.repeats else unambiguous(found)
            known.unsearched = 0
        known.learn(found, time_s)
        return _detections(found, known.ratios.factors(), image, time_s, unit_id)

    def _is_due(self, known: ImageEstimates) -> bool:
        """Whether the whole image is to be searched though all markers that are known were found."""
        return known.unsearched >= SEARCH_INTERVAL

    def looks(self, image: Image) -> tuple[Look, Look]:
        """Return what both looks at a whole image see, by which an image without memory is searched.

        Nothing is learned. What `detect` reports of such an image is what both looks found, but for ids that
        repeat.

        Raises:
            InputError: the image is not a grey one of 8 bits, or is empty.
        """
        return look_twice(check_grey(image), self.dictionary, ImageEstimates(), self._nothing.homographies)

    def look_at(self, image: Image, candidates: DecodedQuads) -> Look:
        """Return what is fitted where candidates are, each by itself, that the search need not have found.

        Raises:
            InputError: the image is not a grey one of 8 bits, or is empty.
        """
        image, known = check_grey(image), ImageEstimates()
        looks = [
            look_at_candidates(
                image, self.dictionary, known, candidates.corners_px, candidates.take(np.array([row]))
            )
            for row in range(candidates.ids.size)
        ]
        return reduce(Look.joined, looks, Look.of_nothing(self.dictionary))

    def _search(
        self, image: Image, known: ImageEstimates, followed: LocalHomographies, *, thoroughly: bool
    ) -> FitResults:
        """Verified markers anywhere in the image but where markers are followed already.

        If it is not to be done thoroughly, the second look may be left out.
        """
        known.first_looks += 1
        interval = SECOND_LOOK_AFTER_SUCCESS if known.is_second_look_worth_it else SECOND_LOOK_INTERVAL
        if not thoroughly and known.first_looks < interval:
            min_darkness = FAINT_SHARE * (known.contrast or 0.0)
            quads = find_quads(image, to_points(followed.images(SQUARE_CORNERS)), min_darkness)
            return look_at_quads(image, self.dictionary, known, quads, followed, MIN_CORRELATION).found
        first, second = look_twice(image, self.dictionary, known, followed)
        known.first_looks, known.is_second_look_worth_it = 0, bool(second.good.any())
        return first.found.joined(second.found)


def _detections(
    found: FitResults, variance_factors: Array, image: Image, time_s: float, unit_id: int
) -> Detections:
    """Detections of what was found, with variances of positions and headings times two factors (2,)."""
    scales = np.sqrt(variance_factors[[0, 0, 1]])
    return Detections(
        unit_id=unit_id,
        time_s=time_s,
        image_size_px=np.array([image.shape[1], image.shape[0]]),
        ids=found.ids,
        centers_px=to_points(found.homographies.centers),
        headings_rad=found.homographies.headings_rad(),
        sides_px=found.homographies.sides_px(),
        corners_px=to_points(found.homographies.images(SQUARE_CORNERS)),
        covariances=scales[:, None] * found.covariances * scales,
    )
