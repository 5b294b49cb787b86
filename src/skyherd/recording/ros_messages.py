"""Content of ROS messages: headers, twists, detections, poses and transforms."""

from collections.abc import Callable
from typing import Any

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from skyherd.files.ros_types import make_typestore
from skyherd.geometry import Array
from skyherd.messages import Detection, Detections

SCORE = 1.0
"""Score of a detection. Chosen: the detector accepts a marker or does not."""

POSE_AXES = np.ix_((0, 1, 5), (0, 1, 5))
"""Places of x, y and the rotation about z in the covariance of a pose. Defined by geometry_msgs."""

TAG_CORNERS = np.array([[-1, 1], [1, 1], [1, -1], [-1, -1]], dtype=np.float32)
"""Corners of a tag in its own coordinates, in the order of apriltag_msgs: x to its right, y to its bottom.
Defined by AprilTag 3."""

APRILTAG_ORDER, OTHER_ORDER = [1, 0, 3, 2], [3, 2, 1, 0]
"""Rows of `Detection.corners_px` in that order. The first is for the families of AprilTag, whose markers
OpenCV's dictionaries and this project turn by 180 degrees; the second for other markers."""


class RosMessages:
    """Maker of messages of ROS 2.

    Args:
        where: the option or address that needs them, for errors.

    Attributes:
        store: type store of `rosbags`.

    Raises:
        InputError: `rosbags` is not installed.
    """

    def __init__(self, where: str) -> None:
        self.store = make_typestore(where)

    def make(self, kind: str) -> Callable[..., Any]:
        """Return the class of a type such as `geometry_msgs/Twist`."""
        package, name = kind.split("/")
        made: Callable[..., Any] = self.store.types[f"{package}/msg/{name}"]
        return made

    def data(self, message: Any) -> bytes:
        """Return a message in little-endian CDR."""
        return bytes(self.store.serialize_cdr(message, message.__msgtype__))

    def header(self, stamp_ns: int, frame: str) -> Any:
        """Return a header of a time since 1970, ns, and a frame."""
        seconds, nanoseconds = divmod(stamp_ns, 10**9)
        stamp = self.make("builtin_interfaces/Time")(sec=seconds, nanosec=nanoseconds)
        return self.make("std_msgs/Header")(stamp=stamp, frame_id=frame)

    def vector(self, values: Array | tuple[float, float, float]) -> Any:
        """Return a vector of three numbers."""
        x, y, z = map(float, values)
        return self.make("geometry_msgs/Vector3")(x=x, y=y, z=z)

    def quaternion(self, rotation: Rotation) -> Any:
        """Return a rotation as a quaternion."""
        x, y, z, w = rotation.as_quat().tolist()
        return self.make("geometry_msgs/Quaternion")(x=x, y=y, z=z, w=w)

    def twist(self, header: Any, linear: tuple[float, float, float], turn_radps: float) -> Any:
        """Return a TwistStamped of a speed, m/s, and a turn rate about z."""
        twist = self.make("geometry_msgs/Twist")(
            linear=self.vector(linear), angular=self.vector((0.0, 0.0, turn_radps))
        )
        return self.make("geometry_msgs/TwistStamped")(header=header, twist=twist)

    def detections(self, header: Any, found: Detections) -> Any:
        """Return the markers of an image as a Detection2DArray, px."""
        entries = [self._detection(header, marker) for marker in found]
        return self.make("vision_msgs/Detection2DArray")(header=header, detections=entries)

    def _detection(self, header: Any, marker: Detection) -> Any:
        u_px, v_px = marker.center_px.tolist()
        covariance = np.zeros((6, 6))
        covariance[POSE_AXES] = marker.covariance
        hypothesis = self.make("vision_msgs/ObjectHypothesisWithPose")(
            hypothesis=self.make("vision_msgs/ObjectHypothesis")(class_id=str(marker.id), score=SCORE),
            pose=self._uncertain_pose(
                (u_px, v_px, 0.0), Rotation.from_euler("z", marker.heading_rad), covariance
            ),
        )
        center = self.make("vision_msgs/Pose2D")(
            position=self.make("vision_msgs/Point2D")(x=u_px, y=v_px), theta=marker.heading_rad
        )
        box = self.make("vision_msgs/BoundingBox2D")(
            center=center, size_x=marker.side_px, size_y=marker.side_px
        )
        return self.make("vision_msgs/Detection2D")(
            header=header, results=[hypothesis], bbox=box, id=str(marker.id)
        )

    def tags(self, header: Any, found: Detections, dictionary: str) -> Any:
        """Return the markers of an image as an AprilTagDetectionArray, px.

        The family is named as in AprilTag (`tag36h11`), or by the dictionary. Wrong bits, goodness and
        decision margin are 0, since the detector has other measures.
        """
        entries = [self._tag(marker, dictionary) for marker in found]
        return self.make("apriltag_msgs/AprilTagDetectionArray")(header=header, detections=entries)

    def _tag(self, marker: Detection, dictionary: str) -> Any:
        point = self.make("apriltag_msgs/Point")
        family = dictionary.replace("APRILTAG_", "tag")
        order = OTHER_ORDER if family == dictionary else APRILTAG_ORDER
        corners = marker.corners_px[order].astype(np.float32)
        u_px, v_px = marker.center_px.tolist()
        return self.make("apriltag_msgs/AprilTagDetection")(
            family=family,
            id=marker.id,
            hamming=0,
            goodness=0.0,
            decision_margin=0.0,
            centre=point(x=u_px, y=v_px),
            corners=[point(x=x, y=y) for x, y in marker.corners_px[order].tolist()],
            homography=cv2.getPerspectiveTransform(TAG_CORNERS, corners).ravel(),
        )

    def _uncertain_pose(
        self, place: tuple[float, float, float] | Array, rotation: Rotation, covariance: Array
    ) -> Any:
        x, y, z = map(float, place)
        pose = self.make("geometry_msgs/Pose")(
            position=self.make("geometry_msgs/Point")(x=x, y=y, z=z), orientation=self.quaternion(rotation)
        )
        return self.make("geometry_msgs/PoseWithCovariance")(pose=pose, covariance=covariance.ravel())

    def pose(self, header: Any, place_m: Array, rotation: Rotation, covariance: Array) -> Any:
        """Return a PoseWithCovarianceStamped.

        Args:
            header: its frame has the axes of the pose.
            place_m: (3,) position.
            rotation: from the axes of the body to those of the frame.
            covariance: (6, 6) of the position, m, and a rotation about the axes of the frame, rad.
        """
        return self.make("geometry_msgs/PoseWithCovarianceStamped")(
            header=header, pose=self._uncertain_pose(place_m, rotation, covariance)
        )

    def transform(
        self, header: Any, child: str, place_m: Array | tuple[float, float, float], rotation: Rotation
    ) -> Any:
        """Return a TransformStamped: the pose of a child frame in the header's frame."""
        transform = self.make("geometry_msgs/Transform")(
            translation=self.vector(place_m), rotation=self.quaternion(rotation)
        )
        return self.make("geometry_msgs/TransformStamped")(
            header=header, child_frame_id=child, transform=transform
        )
