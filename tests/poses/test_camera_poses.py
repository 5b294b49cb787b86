"""Covariances of poses that include the planar ambiguity."""

import numpy as np
from pose_scenes import CALIBRATIONS, drawn_corners, nees, random_pose

from skyherd.poses import camera_poses


def test_total_covariance_holds_where_the_tilt_is_ambiguous() -> None:
    """Markers of 24 px. Some are reported as the mirror image. The mean NEES should be 6.

    Its relative standard deviation is at least sqrt(2 / 6 / 300) = 3 %; the bounds are those of other NEES.
    """
    rng = np.random.default_rng(4)
    calibration, side_m, totals, plain = CALIBRATIONS["pinhole"], 0.08, [], []
    for _ in range(300):
        rotation, place = random_pose(rng, rng.uniform(20, 40), 3.0)
        corners, covariance = drawn_corners(rng, rotation, place, calibration, side_m, 0.1)
        found = camera_poses(corners[None], covariance[None], calibration, side_m, one_plane=False)
        given = (rotation, place), (found.rotations[0], found.translations_m[0])
        totals.append(nees(*given, found.total_covariances()[0]))
        plain.append(nees(*given, found.covariances[0]))
    assert np.mean(plain) > 100 * 6
    assert 0.8 * 6 < np.mean(totals) < 1.25 * 6
