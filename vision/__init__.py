"""From images to detections: the public API of the package for the rest of skyherd.

`create_detector` creates a detector by name, and `Detector` is the interface of all detectors. `explain`
returns the reasons why markers were not detected, and `suggest` returns settings to try. `measure_outlines`
fits detected markers again, for corners with full covariances. `measure_marker_images` gives their light and
blur. `fuse_markers` joins the markers of a robot.
"""

from skyherd.vision.detectors.accuracy import DetectorAccuracy, load_accuracy
from skyherd.vision.detectors.corners import detections_of_corners
from skyherd.vision.detectors.peers import APRILTAG_FAMILIES, LOCUS_FAMILIES, PeerDetector, peer_names
from skyherd.vision.detectors.registry import (
    DEFAULT_DETECTOR,
    DEFAULT_DICTIONARY,
    REPORT_REPEATS,
    Detector,
    check_detector_name,
    create_detector,
    detector_names,
    explain_mirrored,
)
from skyherd.vision.diagnosis.explain import Rejection, detect_and_explain, explain
from skyherd.vision.diagnosis.reading import Reading
from skyherd.vision.diagnosis.reasons import Reason
from skyherd.vision.fusion.fuse import fuse_markers
from skyherd.vision.photometric.detector import DeferringDetector, PhotometricDetector
from skyherd.vision.photometric.remeasure import MarkerImages, measure_marker_images, measure_outlines
from skyherd.vision.photometric.verify import MAX_BLUR_CELLS, MIN_MARKER_CONTRAST
from skyherd.vision.prints.suggestions import find_dictionary, suggest

__all__ = [
    "APRILTAG_FAMILIES",
    "DEFAULT_DETECTOR",
    "DEFAULT_DICTIONARY",
    "LOCUS_FAMILIES",
    "MAX_BLUR_CELLS",
    "MIN_MARKER_CONTRAST",
    "REPORT_REPEATS",
    "DeferringDetector",
    "Detector",
    "DetectorAccuracy",
    "MarkerImages",
    "PeerDetector",
    "PhotometricDetector",
    "Reading",
    "Reason",
    "Rejection",
    "check_detector_name",
    "create_detector",
    "detect_and_explain",
    "detections_of_corners",
    "detector_names",
    "explain",
    "explain_mirrored",
    "find_dictionary",
    "fuse_markers",
    "load_accuracy",
    "measure_marker_images",
    "measure_outlines",
    "peer_names",
    "suggest",
]
