"""Message types of ROS 2 Jazzy, and those of vision_msgs and apriltag_msgs, which `rosbags` lacks."""

from typing import Any

from skyherd.plugins import import_extra

VISION_MSGS = {
    "Point2D": "float64 x\nfloat64 y\n",
    "Pose2D": "vision_msgs/Point2D position\nfloat64 theta\n",
    "BoundingBox2D": "vision_msgs/Pose2D center\nfloat64 size_x\nfloat64 size_y\n",
    "ObjectHypothesis": "string class_id\nfloat64 score\n",
    "ObjectHypothesisWithPose": (
        "vision_msgs/ObjectHypothesis hypothesis\ngeometry_msgs/PoseWithCovariance pose\n"
    ),
    "Detection2D": (
        "std_msgs/Header header\nvision_msgs/ObjectHypothesisWithPose[] results\n"
        "vision_msgs/BoundingBox2D bbox\nstring id\n"
    ),
    "Detection2DArray": "std_msgs/Header header\nvision_msgs/Detection2D[] detections\n",
}
"""Definitions of vision_msgs 4."""

APRILTAG_MSGS = {
    "Point": "float64 x\nfloat64 y\n",
    "AprilTagDetection": (
        "string family\nint32 id\nint32 hamming\nfloat32 goodness\nfloat32 decision_margin\n"
        "apriltag_msgs/Point centre\napriltag_msgs/Point[4] corners\nfloat64[9] homography\n"
    ),
    "AprilTagDetectionArray": ("std_msgs/Header header\napriltag_msgs/AprilTagDetection[] detections\n"),
}
"""Definitions of apriltag_msgs 2."""


def make_typestore(where: str) -> Any:
    """Return a new type store of `rosbags` with all message types that are read or written.

    Args:
        where: the file or option that needs it, for errors.

    Raises:
        InputError: `rosbags` is not installed.
    """
    typesys = import_extra("rosbags.typesys", "rosbags", where, "ros")
    store = typesys.get_typestore(typesys.Stores.ROS2_JAZZY)
    for package, definitions in (("vision_msgs", VISION_MSGS), ("apriltag_msgs", APRILTAG_MSGS)):
        for name, text in definitions.items():
            store.register(typesys.get_types_from_msg(text, f"{package}/msg/{name}"))
    return store
