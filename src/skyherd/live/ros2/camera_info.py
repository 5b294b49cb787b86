"""Calibration of a camera from its `sensor_msgs/CameraInfo`."""

from typing import Any

from skyherd.errors import InputError
from skyherd.files.ros_types import make_typestore
from skyherd.live.ros2.names import Place, Quality, Topic
from skyherd.live.ros2.session import RosNode
from skyherd.poses import Calibration, calibration_of

CAMERA_INFO = "sensor_msgs/msg/CameraInfo"
"""Type of the messages."""


def camera_info_topic(image_topic: str) -> str:
    """Return the topic of the calibration beside an image topic, as `image_transport` names it."""
    parts = image_topic.split("/")
    if parts[-1].startswith("compressed"):
        parts = parts[:-1]
    return "/".join([*parts[:-1], "camera_info"])


class CameraInfoWatch:
    """Subscription to the calibration of a camera.

    Args:
        place: router, domain and node of the subscription.
        image_topic: topic of the camera's images.

    Attributes:
        name: topic of the calibration, without a leading slash.
        trouble: why the last message is not used, in one line; None for a good one or none.

    Raises:
        InputError: the router does not answer, or a library is missing.
    """

    def __init__(self, place: Place, image_topic: str) -> None:
        self.name = camera_info_topic(image_topic)
        self.trouble: str | None = None
        where = f"camera ros2://{place.host}:{place.port}/{self.name}"
        self._store = make_typestore(where)
        self._data = self._last = b""
        self._calibration: Calibration | None = None
        self._node = RosNode(place, where)
        topic = Topic(self.name, CAMERA_INFO, self._store.hash_rihs01(CAMERA_INFO))
        self._node.subscribe(topic, Quality(depth=1), self._take)

    def _take(self, data: bytes) -> None:
        self._data = data

    def newest(self) -> Calibration | None:
        """Return the calibration of the last message; None if there is no valid one."""
        data = self._data
        if data != self._last:
            self._last = data
            try:
                self._calibration, self.trouble = self._read(data), None
            except InputError as error:
                self._calibration, self.trouble = None, str(error)
        return self._calibration

    def _read(self, data: bytes) -> Calibration:
        where = f"/{self.name}"
        try:
            message: Any = self._store.deserialize_cdr(data, CAMERA_INFO)
        except Exception as error:  # the library raises errors of many kinds
            raise InputError(where, f"damaged message ({error})", f"a {CAMERA_INFO}") from None
        if message.k[0] == 0:
            raise InputError(where, "the camera is not calibrated (k[0] is 0)", "a calibrated camera")
        keys = ("width", "height", "distortion_model")
        values = {key: getattr(message, key) for key in keys}
        return calibration_of(where, values | {"k": message.k.tolist(), "d": message.d.tolist()})

    def close(self) -> None:
        """Close the session."""
        self._node.close()
