"""Markers of a camera as messages of ROS 2: detections, tags, poses and transforms.

Topics below a namespace, by default `skyherd`, I being the id of a marker:

```text
detections       vision_msgs/Detection2DArray               markers of an image, px
tags             apriltag_msgs/AprilTagDetectionArray       the same for users of AprilTag, px
marker_I/pose    geometry_msgs/PoseWithCovarianceStamped    pose in the camera's axes, m
/tf              tf2_msgs/TFMessage                         the same poses, frames marker_I
```

Poses need the markers' side and a calibration. Their frame is that of the image: x right, y down, z ahead
(REP 103). A marker's frame has x forward, y left and z out of its face. The headers are those of the images.
"""

from scipy.spatial.transform import Rotation

from skyherd.files.images import Grey
from skyherd.live.cameras import Origin
from skyherd.live.ros2.names import Place, Quality, Topic
from skyherd.live.ros2.session import Publisher, RosNode
from skyherd.messages import Detections
from skyherd.poses import Calibration, CameraPoses, camera_poses
from skyherd.recording.ros_messages import RosMessages
from skyherd.vision import measure_outlines

DETECTIONS, TAGS = "vision_msgs/msg/Detection2DArray", "apriltag_msgs/msg/AprilTagDetectionArray"
POSE, TRANSFORMS = "geometry_msgs/msg/PoseWithCovarianceStamped", "tf2_msgs/msg/TFMessage"
"""Types of the published messages."""

TF = "tf"
"""Topic of transforms. *Defined* by tf2."""

RELIABLE = Quality(depth=10)
"""Quality of service of our publishers. *Chosen*: the default of ROS 2."""

TF_QUALITY = Quality(depth=100)
"""Quality of service of transforms. *Defined* by tf2."""


class MarkerPublisher:
    """Publisher of the markers of one camera.

    Args:
        place: router, domain and node.
        namespace: prefix of the topics.
        where: the address, for errors.

    Raises:
        InputError: the router does not answer, or a library is missing.
    """

    def __init__(self, place: Place, namespace: str, where: str) -> None:
        self._messages = RosMessages(where)
        self._node, self._namespace = RosNode(place, where), namespace
        self._publishers: dict[str, Publisher] = {}
        self._detections = self._advertise("detections", DETECTIONS)
        self._tags = self._advertise("tags", TAGS)

    def _advertise(self, name: str, kind: str) -> Publisher:
        if name not in self._publishers:
            full = name if name == TF else f"{self._namespace}/{name}"
            quality = TF_QUALITY if name == TF else RELIABLE
            topic = Topic(full, kind, self._messages.store.hash_rihs01(kind))
            self._publishers[name] = self._node.advertise(topic, quality)
        return self._publishers[name]

    def publish(self, origin: Origin, found: Detections, dictionary: str) -> None:
        """Publish the markers of an image as detections and tags.

        Raises:
            OSError: they cannot be published.
        """
        header = self._messages.header(origin.stamp_ns, origin.frame)
        for publisher, message in (
            (self._detections, self._messages.detections(header, found)),
            (self._tags, self._messages.tags(header, found, dictionary)),
        ):
            publisher.put(self._messages.data(message), origin.stamp_ns)

    def publish_poses(self, origin: Origin, found: Detections, poses: CameraPoses) -> None:
        """Publish the poses of the markers, and their transforms.

        Raises:
            OSError: they cannot be published.
        """
        make, stamp_ns = self._messages, origin.stamp_ns
        header = make.header(stamp_ns, origin.frame)
        transforms = []
        rows = zip(
            found.ids.tolist(),
            poses.translations_m,
            poses.rotations,
            poses.total_covariances(),
            strict=True,
        )
        for marker, place_m, rotation, covariance in rows:
            turn, name = Rotation.from_matrix(rotation), f"marker_{marker}"
            message = make.pose(header, place_m, turn, covariance)
            self._advertise(f"{name}/pose", POSE).put(make.data(message), stamp_ns)
            transforms.append(make.transform(header, name, place_m, turn))
        message = make.make("tf2_msgs/TFMessage")(transforms=transforms)
        self._advertise(TF, TRANSFORMS).put(make.data(message), stamp_ns)

    def close(self) -> None:
        """Withdraw the topics, and close the session."""
        self._node.close()


def poses_of(
    image: Grey,
    found: Detections,
    dictionary: str,
    calibration: Calibration,
    side_m: float,
    *,
    one_plane: bool,
) -> CameraPoses:
    """Return the poses of at least one detected marker.

    Args:
        image: grey (height, width).
        found: its markers.
        dictionary: the markers' dictionary.
        calibration: of the camera.
        side_m: side of the black squares.
        one_plane: whether all markers lie on one plane.

    Raises:
        InputError: the image has not the calibrated size.
    """
    calibration.check_image("camera", (image.shape[1], image.shape[0]))
    corners = measure_outlines(image, found, dictionary)
    return camera_poses(*corners, calibration, side_m, one_plane=one_plane)
