"""DesignMatrices to detections."""

from skyherd.vision.detectors.opencv_tuned import ArucoDetector
from skyherd.vision.detectors.registry import Detector, create_detector, detector_names, explain_mirrored
from skyherd.vision.photometric.detector import PhotometricDetector

__all__ = [
    "ArucoDetector",
    "Detector",
    "PhotometricDetector",
    "create_detector",
    "detector_names",
    "explain_mirrored",
]
