"""Images of a ROS 2 topic over Zenoh, `sensor_msgs/Image` or `sensor_msgs/CompressedImage`."""

import threading
import time
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Literal

from skyherd.errors import InputError
from skyherd.files.images import Grey
from skyherd.files.ros_images import COMPRESSED, RAW, DamagedImageError, grey_of_message
from skyherd.files.ros_types import make_typestore
from skyherd.live.cameras.frame import Origin, Picture
from skyherd.live.ros2.names import Quality, Topic, split_address
from skyherd.live.ros2.session import RosNode

EXAMPLE = "ros2://127.0.0.1:7447/camera/image_raw"
"""An address, for error messages."""

TYPES = {"Image": RAW, "CompressedImage": COMPRESSED}
"""Message types by their name in an address."""

KEPT = 10
"""Messages that wait for their decoding; older ones are dropped. *Chosen*: the depth of ROS 2's default."""

READ_S = 3.0
"""Longest time without an image, s, after which the topic counts as silent. *Chosen*: below the time for
which `skyherd live check` waits."""

WAIT_S = 0.2
"""Longest wait between two checks whether the reader is closed, s. *Chosen*."""


class Ros2Camera:
    """Camera whose images come from a topic of ROS 2.

    Args:
        address: `ros2://host:7447/camera/image_raw`, with `?type=CompressedImage`, `domain`, `node` and
            `config` as for drivers. Topics whose name ends with `compressed` have that type by default.

    Raises:
        InputError: the address is invalid, or a library is missing.
    """

    lasting = True
    pace: Literal["live"] = "live"

    def __init__(self, address: str) -> None:
        self.name, where = address, f"camera {address}"
        try:
            self._place, name, options = split_address(
                address, where, options=("type",), node="skyherd_camera"
            )
        except ValueError as error:
            raise InputError(where, str(error), EXAMPLE) from None
        if not name:
            raise InputError(where, "no topic", EXAMPLE)
        usual = "CompressedImage" if name.endswith("compressed") else "Image"
        kind = options.get("type", usual)
        if kind not in TYPES:
            raise InputError(where, f"type {kind!r}", f"one of {', '.join(TYPES)}")
        self._store = make_typestore(where)
        self._topic = Topic(name, TYPES[kind], self._store.hash_rihs01(TYPES[kind]))

    @contextmanager
    def open(self, pause: Callable[[float], bool]) -> Iterator[Iterator[Picture]]:
        """Join the graph and subscribe; see `Source.open`."""
        waiting: deque[bytes] = deque(maxlen=KEPT)
        arrival = threading.Event()

        def take(data: bytes) -> None:
            waiting.append(data)
            arrival.set()

        with RosNode(self._place, f"camera {self.name}") as node:
            node.subscribe(self._topic, Quality(KEPT), take)
            yield self._pictures(node, waiting, arrival, pause)

    def _pictures(
        self,
        node: RosNode,
        waiting: deque[bytes],
        arrival: threading.Event,
        pause: Callable[[float], bool],
    ) -> Iterator[Picture]:
        """Yield the images as they arrive, without damaged ones.

        Raises:
            InputError: none could be read for `READ_S`, or the encoding is not read.
        """
        last_s, damage, first_ns = time.monotonic(), None, 0
        while not pause(0.0):
            arrival.wait(WAIT_S)
            arrival.clear()
            while waiting:
                try:
                    image, origin = self._read(waiting.popleft())
                except DamagedImageError as error:
                    damage = str(error)
                    continue
                first_ns = first_ns or origin.stamp_ns
                # Seconds since the first stamp: those since 1970 have a resolution of 0.2 µs.
                stream_s = (origin.stamp_ns - first_ns) / 1e9 if origin.stamp_ns else None
                yield Picture(image, stream_s, origin=origin)
                last_s, damage = time.monotonic(), None
            if time.monotonic() - last_s >= READ_S:
                raise InputError(self.name, damage or self._silence(node), "a publisher of this topic")

    def _read(self, data: bytes) -> tuple[Grey, Origin]:
        """Return image and header of a message."""
        kind = self._topic.kind
        try:
            message = self._store.deserialize_cdr(data, kind)
        except Exception as error:  # the library raises errors of many kinds
            problem = InputError(self.name, f"damaged message ({error})", f"a {kind}")
            raise DamagedImageError(problem) from None
        image = grey_of_message(self.name, message, kind)
        stamp = message.header.stamp
        return image, Origin(stamp.sec * 10**9 + stamp.nanosec, message.header.frame_id)

    def _silence(self, node: RosNode) -> str:
        """Return why no image arrives, by the topics that are published."""
        published = node.published_topics()
        types = published.get(self._topic.name, set())
        if types:
            shown = ", ".join(sorted(types))
            return (
                f"no image for {READ_S:g} s" if self._topic.kind in types else f"the topic has type {shown}"
            )
        images = sorted(name for name, kinds in published.items() if kinds & {RAW, COMPRESSED})
        there = f"image topics: {', '.join(f'/{name}' for name in images)}" if images else "no image topic"
        return f"no publisher of /{self._topic.name}; domain {self._place.domain} has {there}"
