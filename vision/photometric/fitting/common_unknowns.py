"""Unknowns that all markers of an image share: their plane, uneven light, a bend of the tone curve.

These are hypotheses that are tested on all markers together, which is more precise than on one marker.
They are tested on the markers that look like a print and have all their cells right. Smooth
ground that was taken for a marker can be fitted as well as one, and would put all headings off by half of
their standard deviation.

`vision/native/common_unknowns.c` tests them:

- Light is even unless the pixels contradict it. The growth of the sum of squares where k unknowns are held,
  over the variance of the noise, is a chi-squared of expectation k and variance 2 k. Its mean over the
  markers decides.
- The tone curve is the camera's. Its bend is one share of each contrast: the median over the markers,
  weighted by how precisely each shows it.
- A plane holds the anisotropies and keystones of all markers. Without one, keystones are expected near zero.
"""

from skyherd.vision.native.records import UNKNOWNS
from skyherd.vision.photometric.fitting.plane import Plane

MIN_PIXELS_FOR_PLANE = 2 * UNKNOWNS
"""Markers with fewer pixels do not count for the plane, since their noise is not known. Chosen: half of the
pixels are then degrees of freedom."""

MIN_PRINT_SHARE = 0.6
"""Fits whose print contrast is below this share of the median one are not counted as prints. Chosen loosely:
the final test is `skyherd.vision.photometric.verify.MIN_PRINT_SHARE`, 0.75."""

FREE_SIGMAS = 8.0
"""Light counts as uneven, and the tone curve as bent, once the markers' mean chi-squared exceeds its
expectation by so many of its standard deviations. Chosen: chance does not reach it; a smaller value frees
unknowns of each marker without need."""

MIN_MARKERS_FOR_TONE, MAX_TONE = 4, 2.0
"""The tone curve counts as bent only if so many markers show it, and if the bend is positive and below the
second number. Derived: a camera's gamma of 1 / 2.2 bends by 1.1 to 1.5, and never below the straight line.
Chosen: ground that looks like one marker under some curve must not choose the curve; three may be chance."""

OWN_PLANES = Plane(shared=False)
"""The plane of markers that share none: each has its own anisotropy and keystone."""

KEYSTONE_STD = 0.1
"""Expected size of a marker's own keystone, where no plane says what it is: the standard deviation of each of
its two components, by which the marker's image grows along one side's length. Chosen: that of a marker seen
from four sides away at a tilt of 25 degrees; with a larger one, small markers take keystones from their
noise."""

NEAR_PLANE = 0.02
"""Markers whose anisotropies lie within this of a plane have its keystone, if most of an image's
markers do. A plane does not explain them exactly where a lens bends it or processing feigns anisotropies.
Measured on photographs of boards: anisotropies are 0.002 to 0.005 off, and the keystones found differ from
the plane's by their noise, 0.004 to 0.014. Held there, corners are off by 0.056, 0.124 and 0.140 px on three
boards where free keystones give 0.084, 0.137 and 0.153 px."""
