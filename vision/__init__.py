"""Pixels to detections."""

from skyherd.vision.aruco import ArucoDetector
from skyherd.vision.detector import Detector, create_detector, detector_names, explain_mirrored
from skyherd.vision.photometric import PhotometricDetector

__all__ = [
    "ArucoDetector",
    "Detector",
    "PhotometricDetector",
    "create_detector",
    "detector_names",
    "explain_mirrored",
]
