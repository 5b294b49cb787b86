"""rosbag2 recordings of images, written by `rosbags`."""

from pathlib import Path

import cv2
import numpy as np
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

STORE = get_typestore(Stores.ROS2_JAZZY)
"""Types of the messages."""

BEGUN_NS = 1_700_000_000_000_000_000
"""Time of the first message, ns since 1970."""

STORAGES = {".mcap": StoragePlugin.MCAP, ".db3": StoragePlugin.SQLITE3}
"""Storage by the suffix of its files."""


def header(time_s: float, stamped: bool = True):
    """Return the header of a message, with a stamp `time_s` after the first."""
    seconds, nanoseconds = divmod(BEGUN_NS + round(time_s * 1e9) if stamped else 0, 10**9)
    stamp = STORE.types["builtin_interfaces/msg/Time"](sec=seconds, nanosec=nanoseconds)
    return STORE.types["std_msgs/msg/Header"](stamp=stamp, frame_id="camera")


def raw(levels: np.ndarray, encoding: str, time_s: float = 0.0, *, padding: int = 0, big: bool = False):
    """Return a `sensor_msgs/Image` of levels (height, width) or (height, width, channels)."""
    height, width = levels.shape[:2]
    rows = levels.astype(levels.dtype.newbyteorder(">" if big else "<")).reshape(height, -1).view(np.uint8)
    rows = np.pad(rows, ((0, 0), (0, padding)), constant_values=99)
    return STORE.types["sensor_msgs/msg/Image"](
        header=header(time_s),
        height=height,
        width=width,
        encoding=encoding,
        is_bigendian=int(big),
        step=rows.shape[1],
        data=np.ascontiguousarray(rows).ravel(),
    )


def compressed(image: np.ndarray, time_s: float = 0.0, *, kind: str = ".png", stamped: bool = True):
    """Return a `sensor_msgs/CompressedImage` of grey levels (height, width)."""
    data = cv2.imencode(kind, image)[1].ravel()
    name = f"mono8; {kind[1:]} compressed"
    return STORE.types["sensor_msgs/msg/CompressedImage"](
        header=header(time_s, stamped), format=name, data=data
    )


def text(words: str):
    """Return a `std_msgs/String`."""
    return STORE.types["std_msgs/msg/String"](data=words)


def write_bag(folder: Path, messages, *, storage: str = ".mcap", every_s: float = 0.1) -> Path:
    """Write messages (topic, message) at equal intervals, and return the folder."""
    with Writer(folder, version=9, storage_plugin=STORAGES[storage]) as writer:
        connections = {}
        for number, (topic, message) in enumerate(messages):
            kind = message.__msgtype__
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, kind, typestore=STORE)
            data = STORE.serialize_cdr(message, kind)
            writer.write(connections[topic], BEGUN_NS + round(number * every_s * 1e9), data)
    return folder
