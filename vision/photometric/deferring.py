"""The photometric detector for those who wait for it: what can be searched later is searched later.

Markers that are followed are found in a few milliseconds; the search of the whole image for new ones takes
ten times as long, and all that is known of the other markers would wait for it. Here it is done when the
image's detections have been used, and by parts, one after each image. A marker that comes into view is
reported from the next image on.
"""

from skyherd.geometry import SQUARE_CORNERS, Array, to_points
from skyherd.vision.grey import Image, check_grey
from skyherd.vision.photometric.detector import PhotometricDetector
from skyherd.vision.photometric.image_estimates import ImageEstimates
from skyherd.vision.photometric.look import CLEAR_CORRELATION, look_at_quads
from skyherd.vision.photometric.unknown_blur import with_usual_blur
from skyherd.vision.search.decode import MIN_CORRELATION
from skyherd.vision.search.quads import find_quads
from skyherd.vision.search.second_look import find_opencv_quads, find_small_quads

LOOK_AROUND_INTERVAL = 10
"""Of so many images one is searched whole, by parts. Chosen: the machine of a live unit has other things to
do while it waits for the next image."""

PARTS = 3
"""In so many parts the whole image is searched: for the quadrilaterals of the first look, for those that are
seen at twice the size, and for those that OpenCV finds. *Measured*: of 800 x 800 px they take 8, 18 and 11 ms
in the median, what is fitted there included."""


class DeferringDetector(PhotometricDetector):
    """Follows markers as `PhotometricDetector` does, and leaves most searches to `look_around`.

    `detect` searches the whole image at once only when no marker is known or a followed one is missing.
    Whoever uses it calls `look_around` with the same image once its detections were used; if nobody does,
    markers that come into view are found only when another one is lost.

    Args:
        dictionary: of the markers, such as `4X4_50`.
    """

    def __init__(self, dictionary: str = "4X4_50") -> None:
        super().__init__(dictionary, following=True)

    def look_around(self, image: Image, *, unit_id: int = 0) -> None:
        """Search the image that was given to `detect` last for markers that are not followed, if it is time.

        Of ten images the last `PARTS` are searched, by one part each. What is found is followed from now on;
        an id that is followed elsewhere already is followed no more, since it is at two places.

        Args:
            image: grey, (height, width), uint8.
            unit_id: whose image it is.

        Raises:
            InputError: the image is not a grey one of 8 bits, or is empty.
        """
        image, known = check_grey(image), self.estimates.get(unit_id)
        part = -1 if known is None else known.unsearched - (LOOK_AROUND_INTERVAL - PARTS + 1)
        if known is None or part < 0:
            return
        there = known.tracks.homographies
        known_px = to_points(there.images(SQUARE_CORNERS))
        correlation = CLEAR_CORRELATION if part else MIN_CORRELATION
        quads = self._quads(part, image, known_px)
        found = look_at_quads(image, self.dictionary, known, quads, there, correlation).found
        if found.ids.size:
            known.tracks = known.tracks.with_others(found.ids, found.homographies, with_usual_blur(found))
        if part >= PARTS - 1:
            known.unsearched = 0

    def _is_due(self, known: ImageEstimates) -> bool:
        """Never: `look_around` does that."""
        return False

    def _quads(self, part: int, image: Image, known_px: Array) -> Array:
        """Corners (N, 4, 2), px, of the quadrilaterals that a part of the search finds."""
        if part == 0:
            return find_quads(image)
        if part == 1:
            return find_small_quads(image, known_px)
        return find_opencv_quads(image, known_px, self.dictionary)
