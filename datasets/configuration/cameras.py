"""Test cameras by name, for a scenario's `camera.preset`: common products and common defects.

Angles are half of the view across the image's shorter side.
"""

from collections.abc import Mapping
from typing import Any

CAMERAS: Mapping[str, Mapping[str, Any]] = {
    # Wide-angle action camera: 110 degrees from corner to corner, barrel distortion.
    "action": {
        "size_px": (960, 540),
        "half_angle_deg": 35.0,
        "distortion": {"k1": -0.26, "k2": 0.06},
    },
    # Phone: a small wavy distortion, and a slightly decentred lens.
    "phone": {
        "size_px": (800, 600),
        "half_angle_deg": 27.0,
        "principal_point_px": (408.0, 293.5),
        "distortion": {"k1": 0.08, "k2": -0.12, "p1": 0.001, "p2": -0.0015},
    },
    # Machine-vision camera with a cheap, obliquely mounted lens.
    "machine-vision": {
        "size_px": (720, 720),
        "half_angle_deg": 20.0,
        "distortion": {"k1": -0.12, "p1": 0.003, "p2": 0.002},
    },
    # Fisheye: 120 degrees across the longer side.
    "fisheye": {"size_px": (800, 600), "half_angle_deg": 45.0, "lens": "equidistant"},
    # Zoom lens: barrel distortion at its wide end, pincushion distortion from a zoom of 1.4 on.
    "zoom": {
        "size_px": (720, 576),
        "half_angle_deg": 28.0,
        "distortion": {"k1": -0.17},
        "zoom_k1": 0.34,
    },
    # Non-square pixels, as of a stretched image.
    "oblong": {"size_px": (800, 600), "half_angle_deg": 30.0, "aspect": 640 / 480},
    "skewed": {"size_px": (800, 600), "half_angle_deg": 30.0, "skew": 0.08},
    # The axis meets the image a fifth of its sides off its centre, as in a cropped picture.
    "off-centre": {
        "size_px": (800, 600),
        "half_angle_deg": 30.0,
        "principal_point_px": (559.5, 179.5),
        "distortion": {"k1": -0.12, "k2": 0.02},
    },
}
"""Keys of `CameraModel` for each preset. Chosen to resemble cameras of their kinds; none was calibrated."""
