"""Images in the order of time, from a video or a rosbag2 recording."""

from collections.abc import Generator
from pathlib import Path

from skyherd.errors import InputError
from skyherd.files.rosbag_reader import is_bag, open_bag, read_bag
from skyherd.files.video_reader import Clip, ClipFrame, is_video, open_clip, read_clip


def is_stream(path: Path) -> bool:
    """Return whether a path is a video by its suffix, or a rosbag2 recording."""
    return is_video(path) or is_bag(path)


def open_stream(path: Path, topic: str | None = None) -> Clip:
    """Open a video or a bag to find its rate and length, and close it.

    Args:
        path: the file, or the folder of a bag.
        topic: topic of a bag's images; None for the only one.

    Raises:
        InputError: it cannot be read, has not the topic, or a topic of a video is asked for.
    """
    if is_bag(path):
        return open_bag(path, topic)
    if topic is not None:
        raise InputError("topic", f"{path} is not a rosbag2 recording", "leave it out")
    return open_clip(path)


def read_stream(clip: Clip) -> Generator[ClipFrame]:
    """Read the images, one at a time, as far as possible; see `read_clip` and `read_bag`."""
    return read_clip(clip) if clip.topic is None else read_bag(clip)
