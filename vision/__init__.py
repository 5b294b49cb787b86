"""Pixels to detections."""

from skyherd.vision.aruco import ArucoDetector
from skyherd.vision.detector import Detector, create_detector, detector_names, explain_mirrored

__all__ = ["ArucoDetector", "Detector", "create_detector", "detector_names", "explain_mirrored"]
