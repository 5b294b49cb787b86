"""Steer a world of your own: a function that takes a velocity per robot and returns an image.

Here the world is a few lines of NumPy and OpenCV; put your simulator or your robots in its place.
skyherd is told the shape, the images and the side of the markers on the robots, and nothing else.
"""

import cv2
import numpy as np

from skyherd import AerialController, GoalInboxes, Rectifier, Template, create_detector
from skyherd.control import Hover, MarkerGains, SafetyRadius, robot_commands

IDS, SIDE_M, PX_PER_M, STEP_S = np.arange(4), 0.4, 80.0, 0.1
DICTIONARY = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50)


class MyWorld:
    """Four wheeled robots under one camera."""

    position_m = np.array([[1.5, 2.0], [7.5, 1.5], [6.0, 6.5], [3.0, 5.0]])
    heading_rad = np.array([0.3, 2.0, -1.0, 1.2])

    def drive(self, v_mps: np.ndarray, omega_radps: np.ndarray) -> np.ndarray:
        """Drive for one step; return the camera's image, seen from above."""
        forward = np.column_stack([np.cos(self.heading_rad), np.sin(self.heading_rad)])
        self.position_m = self.position_m + v_mps[:, None] * forward * STEP_S
        self.heading_rad = self.heading_rad + omega_radps * STEP_S
        image = np.full((640, 720), 160, np.uint8)
        for robot, (x, y), heading in zip(IDS, self.position_m, self.heading_rad, strict=True):
            marker = cv2.aruco.generateImageMarker(DICTIONARY, int(robot), 60)
            card = np.pad(marker, 12, constant_values=255)
            turn = cv2.getRotationMatrix2D((41.5, 41.5), np.degrees(heading) - 90, SIDE_M * PX_PER_M / 60)
            turn[:, 2] += [x * PX_PER_M - 41.5, 640 - y * PX_PER_M - 41.5]
            cv2.warpAffine(card, turn, (720, 640), dst=image, borderMode=cv2.BORDER_TRANSPARENT)
        return cv2.GaussianBlur(image, (0, 0), 0.7)


def main() -> np.ndarray:
    """Bring the robots into a square; return their final positions, m."""
    world, detector = MyWorld(), create_detector("tracking", dictionary="4X4_50")
    square = Template.from_ground_points(IDS, [[0, 0], [1, 0], [1, 1], [0, 1]])
    unit = AerialController(square, SafetyRadius(radius=1.2), Hover(), rectifier=Rectifier())
    inboxes = GoalInboxes(IDS, unit_ids=np.array([0]), lifetime_s=0.5)
    gains = MarkerGains(k=0.3, k_omega=1.2, b_th=0.0, side_m=SIDE_M)
    for time_s in np.arange(400) * STEP_S:
        command = robot_commands(inboxes, gains, time_s)
        image = world.drive(command.v_mps, command.omega_radps)
        decision = unit.step(detector.detect(image, time_s=time_s))
        if decision.goals is not None:
            inboxes.receive(decision.goals, time_s)
    return world.position_m


if __name__ == "__main__":
    print("robots end at, m:", main().round(2).tolist())
