"""Reading of the images of a rosbag2 recording, MCAP or SQLite, as grey images one at a time.

The topic has messages of the type `sensor_msgs/Image` or `sensor_msgs/CompressedImage`. The library `rosbags`
reads them without an installation of ROS. The time of an image is the stamp of its header, from that of the
first image. A bag whose end is damaged is read as far as possible, with an `InputWarning`.
"""

import struct
import warnings
from collections.abc import Generator, Iterator
from contextlib import contextmanager
from fractions import Fraction
from pathlib import Path
from typing import Any

from skyherd.errors import InputError, InputWarning
from skyherd.files.reading import is_regular, open_regular
from skyherd.files.ros_images import COMPRESSED, RAW, DamagedImageError, grey_of_message
from skyherd.files.ros_types import make_typestore
from skyherd.files.video_reader import USUAL_RATE_HZ, Clip, ClipFrame
from skyherd.plugins import import_extra
from skyherd.text import printable

METADATA = "metadata.yaml"
"""Name of the file in the folder of a bag. Defined by rosbag2."""

INFORMATION, HEAD_BYTES = b"rosbag2_bagfile_information", 65536
"""The key of that file, and the number of its first bytes that are searched. Defined by rosbag2, which writes
it first; chosen: room for comments."""

SQLITE_SUFFIX, MCAP_SUFFIX = ".db3", ".mcap"
"""Suffixes of the storage files of a bag. Defined by rosbag2."""

MCAP_START, ROS_PROFILE = b"\x89MCAP0\r\n\x01", b"ros2"
"""First bytes of an MCAP file up to the kind of its first record, and the profile in it. Defined by MCAP."""

GIVE_A_BAG = "give the folder of a rosbag2 recording, or its .mcap or .db3 file"
"""Advice in error messages about bags."""


def is_bag(path: Path) -> bool:
    """Return whether a path is a rosbag2 recording: its folder, an SQLite file, or an MCAP file of ROS 2."""
    if is_regular(path / METADATA):
        return INFORMATION in _head(path / METADATA, HEAD_BYTES)
    if not is_regular(path):
        return False
    return path.suffix == SQLITE_SUFFIX or (path.suffix == MCAP_SUFFIX and _is_of_ros(path))


def _is_of_ros(path: Path) -> bool:
    """Return whether the header of an MCAP file has the profile of ROS 2."""
    start = _head(path, len(MCAP_START) + 12 + len(ROS_PROFILE))
    length = struct.pack("<I", len(ROS_PROFILE))
    return start.startswith(MCAP_START) and start[len(MCAP_START) + 8 :] == length + ROS_PROFILE


def _head(path: Path, count: int) -> bytes:
    """Return the first bytes of a file; none if it cannot be read."""
    try:
        with open_regular(path, GIVE_A_BAG) as stream:
            return stream.read(count)
    except (InputError, OSError):
        return b""


def open_bag(path: Path, topic: str | None = None) -> Clip:
    """Open a bag to find its images, and close it.

    Args:
        path: the folder or file.
        topic: topic of the images; None for the only one.

    Raises:
        InputError: it cannot be read, or has no such topic, none or several.
    """
    with _open_reader(path) as reader:
        topic = _image_topic(path, reader, topic)
        count = sum(connection.msgcount for connection in reader.connections if connection.topic == topic)
        seconds = reader.duration / 1e9
        rate = Fraction(count / seconds).limit_denominator(1000) if count > 1 and seconds else Fraction(0)
        return Clip(path, rate or USUAL_RATE_HZ, count, topic=topic)


def read_bag(clip: Clip) -> Generator[ClipFrame]:
    """Read the images of a topic, one at a time, in the order of the bag.

    Warns with `InputWarning` at the end if images are damaged or missing.

    Raises:
        InputError: an image has an encoding that is not read, or no image can be read.
    """
    index, left_out, first_ns, trouble = 0, 0, None, None
    with _open_reader(clip.path) as reader:
        wanted = [connection for connection in reader.connections if connection.topic == clip.topic]
        messages = reader.messages(wanted)
        while True:
            try:
                connection, logged_ns, data = next(messages)
            except StopIteration:
                break
            except Exception as error:  # the library raises errors of many kinds
                trouble = _unreadable(clip.path, error)
                break
            try:
                message = reader.deserialize(data, connection.msgtype)
            except Exception as error:
                trouble, left_out = _unreadable(clip.path, error), left_out + 1
                continue
            stamp = message.header.stamp
            time_ns = stamp.sec * 10**9 + stamp.nanosec or logged_ns
            try:
                image = grey_of_message(
                    f"{clip.path}: {clip.topic}: image {index}", message, connection.msgtype
                )
            except DamagedImageError as error:
                trouble, left_out = error.problem, left_out + 1
                continue
            first_ns = time_ns if first_ns is None else first_ns
            yield ClipFrame(index, (time_ns - first_ns) / 1e9, image)
            index += 1
    if not index:
        raise trouble or InputError(f"{clip.path}: {clip.topic}", "has no image", GIVE_A_BAG)
    missing = max(left_out, clip.count - index)
    if trouble is not None or missing:
        what = f"damaged or cut short: {index} images are read, {missing} are not"
        warnings.warn(InputWarning(f"{clip.path}: {what}"), stacklevel=2)


@contextmanager
def _open_reader(path: Path) -> Iterator[Any]:
    """Open a bag.

    Raises:
        InputError: `rosbags` is not installed, or the bag cannot be read.
    """
    highlevel = import_extra("rosbags.highlevel", "rosbags", str(path), "ros")
    typestore = make_typestore(str(path))
    try:
        reader = highlevel.AnyReader([path], default_typestore=typestore)
        reader.open()
    except Exception as error:  # the library raises errors of many kinds
        raise _unreadable(path, error) from None
    try:
        yield reader
    finally:
        reader.close()


def _image_topic(path: Path, reader: Any, topic: str | None) -> str:
    """Return the topic of the images."""
    found = sorted({one.topic for one in reader.connections if one.msgtype in (RAW, COMPRESSED)})
    names = ", ".join(map(printable, found))
    if not found:
        raise InputError(str(path), "has no image topic", f"a bag with {RAW} or {COMPRESSED}")
    if topic is None and len(found) > 1:
        raise InputError(str(path), f"has {len(found)} image topics", f"choose one with `topic=`: {names}")
    if topic is not None and topic not in found:
        raise InputError("topic", f"{path} has no image topic {topic!r}", f"one of {names}")
    return found[0] if topic is None else topic


def _unreadable(path: Path, error: Exception) -> InputError:
    why = printable(" ".join(str(error).split())) or type(error).__name__
    return InputError(str(path), f"cannot be read as a rosbag2 recording ({why})", GIVE_A_BAG)
