"""Measure `skyherd ros2` with a peer that speaks `rmw_zenoh`: loss and latency of detections.

    python benchmarks/ros_bridge.py [--seconds 10] [--rate 30]

A Zenoh router runs in this process. A peer writes images by `rosbags` with the keys, tokens and attachments
of `rmw_zenoh_cpp`, and reads the detections by `rosbags`. `skyherd ros2` runs in a process of its own.
Latency is the time from the publication of an image to the arrival of its detections, on one machine.
"""

import argparse
import socket
import struct
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import cv2
import numpy as np
import zenoh
from command import run

from skyherd.files.ros_types import make_typestore
from skyherd.geometry import Array
from skyherd.markers.dictionary import marker_cells

IDS = (3, 8, 21, 40)
"""Markers in the images."""

CELL_PX = 6
"""Width of a marker's cell, px."""

NOISE = 2.0
"""Standard deviation of the images' noise, grey levels."""

DETECTIONS = "vision_msgs/msg/Detection2DArray"
POSE = "geometry_msgs/msg/PoseWithCovarianceStamped"


class Peer:
    """A node of ROS 2 with `rmw_zenoh`, written from its design with `rosbags` and without `skyherd.live`.

    Args:
        session: a Zenoh session.
        topic: topic of the images, without a leading slash.
    """

    def __init__(self, session: Any, topic: str = "camera/image_raw") -> None:
        self.store = make_typestore("peer")
        self.session, self._number = session, 0
        self.received: dict[int, tuple[float, Any]] = {}
        self.stamps_ns: list[int] = []
        zid = str(session.zid())
        self._tokens = [session.liveliness().declare_token(f"@ros2_lv/0/{zid}/0/0/NN/%/%/peer")]
        self.topic = topic
        self._zid = zid

    def key(self, topic: str, kind: str) -> str:
        """Return the key expression of a topic in domain 0."""
        package, _, name = kind.split("/")
        return f"0/{topic}/{package}::msg::dds_::{name}_/{self.store.hash_rihs01(kind)}"

    def announce(self, topic: str, kind: str) -> None:
        """Declare the token of a publisher with the quality of sensor data: best effort, 5 kept."""
        _, *rest = self.key(topic, kind).split("/")
        mangled = "%" + topic.replace("/", "%")
        end = "/".join(rest[-2:])
        token = f"@ros2_lv/0/{self._zid}/0/1/MP/%/%/peer/{mangled}/{end}/2::,5:,:,:,,"
        self._tokens.append(self.session.liveliness().declare_token(token))

    def listen(self, topic: str, kind: str) -> None:
        """Keep each message of a topic by its stamp, ns, with the time of its arrival, and all stamps."""

        def take(sample: Any) -> None:
            arrived_s = time.monotonic()
            message = self.store.deserialize_cdr(bytes(sample.payload), kind)
            stamp = message.header.stamp
            self.stamps_ns.append(stamp.sec * 10**9 + stamp.nanosec)
            self.received[self.stamps_ns[-1]] = arrived_s, message

        self._subscriber = self.session.declare_subscriber(self.key(topic, kind), take)

    def header(self, stamp_ns: int) -> Any:
        """Return a header."""
        types = self.store.types
        stamp = types["builtin_interfaces/msg/Time"](*divmod(stamp_ns, 10**9))
        return types["std_msgs/msg/Header"](stamp=stamp, frame_id="optical_frame")

    def image(self, image: np.ndarray, stamp_ns: int, *, jpeg: bool = False) -> Any:
        """Return an image (height, width) as a message."""
        types, header = self.store.types, self.header(stamp_ns)
        if jpeg:
            data = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, 90])[1].ravel()
            return types["sensor_msgs/msg/CompressedImage"](header, "mono8; jpeg compressed mono8", data)
        height, width = image.shape
        return types["sensor_msgs/msg/Image"](header, height, width, "mono8", 0, width, image.ravel())

    def camera_info(self, width: int, height: int, focal_px: float) -> Any:
        """Return the calibration of a pinhole camera."""
        types = self.store.types
        matrix = np.array([focal_px, 0, (width - 1) / 2, 0, focal_px, (height - 1) / 2, 0, 0, 1])
        region = types["sensor_msgs/msg/RegionOfInterest"](0, 0, 0, 0, False)
        projection = np.hstack([matrix.reshape(3, 3), np.zeros((3, 1))]).ravel()
        return types["sensor_msgs/msg/CameraInfo"](
            self.header(0),
            height,
            width,
            "plumb_bob",
            np.zeros(5),
            matrix,
            np.eye(3).ravel(),
            projection,
            0,
            0,
            region,
        )

    def put(self, topic: str, message: Any) -> None:
        """Publish a message with the attachment of `rmw_zenoh`."""
        self._number += 1
        kind = message.__msgtype__
        attachment = struct.pack("<qqB", self._number, time.time_ns(), 16) + bytes(range(16))
        data = bytes(self.store.serialize_cdr(message, kind))
        self.session.put(self.key(topic, kind), data, attachment=attachment)


@contextmanager
def router(port: int = 0) -> Iterator[tuple[Any, int]]:
    """Run a Zenoh router on loopback, on a free port for 0, and return its session and port."""
    if port == 0:
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            port = free.getsockname()[1]
    configuration = zenoh.Config()
    configuration.insert_json5("mode", '"router"')
    configuration.insert_json5("listen/endpoints", f'["tcp/127.0.0.1:{port}"]')
    configuration.insert_json5("scouting/multicast/enabled", "false")
    with zenoh.open(configuration) as session:
        yield session, port


def centers_px(number: int, size_px: tuple[int, int]) -> Array:
    """Return the centres (N, 2) of the markers in an image; they move on circles, half a turn in 5 s."""
    width, height = size_px
    angle = number * np.pi / 150 + 0.3
    middles = np.array([[0.25, 0.3], [0.75, 0.3], [0.25, 0.7], [0.75, 0.7]]) * (width, height)
    return middles + 0.06 * min(size_px) * np.array([np.cos(angle), np.sin(angle)])


def draw(number: int, size_px: tuple[int, int], rng: np.random.Generator) -> np.ndarray:
    """Return an image (height, width) of the moving markers with noise."""
    width, height = size_px
    image = np.full((height, width), 150, np.float32)
    for marker, center in zip(IDS, centers_px(number, size_px), strict=True):
        cells = np.pad(marker_cells("4X4_50", marker), 1, constant_values=True)
        card = np.kron(np.where(cells, 220, 40), np.ones((CELL_PX, CELL_PX))).astype(np.float32)
        shift = center - (card.shape[0] - 1) / 2
        warp = np.array([[1, 0, shift[0]], [0, 1, shift[1]]])
        cv2.warpAffine(card, warp, (width, height), image, cv2.INTER_LINEAR, cv2.BORDER_TRANSPARENT)
    image = cv2.GaussianBlur(image, (0, 0), 0.7) + NOISE * rng.standard_normal(image.shape, dtype=np.float32)
    return np.clip(np.rint(image), 0, 255).astype(np.uint8)


def stream(
    peer: Peer, images: list[np.ndarray], rate_hz: float, *, jpeg: bool = False, info: Any = None
) -> dict[int, float]:
    """Publish images at a rate, and return the time of each publication by stamp, ns."""
    sent: dict[int, float] = {}
    begun_s, begun_ns = time.monotonic(), time.time_ns()
    for number, image in enumerate(images):
        due_s = begun_s + number / rate_hz
        time.sleep(max(0.0, due_s - time.monotonic()))
        stamp_ns = begun_ns + round(number / rate_hz * 1e9)
        message = peer.image(image, stamp_ns, jpeg=jpeg)
        if info is not None:
            peer.put("camera/camera_info", info)
        sent[stamp_ns] = time.monotonic()
        peer.put(peer.topic, message)
    return sent


def wait_for(condition: Any, timeout_s: float = 20.0) -> bool:
    """Wait until a condition holds; return whether it does."""
    ends_s = time.monotonic() + timeout_s
    while not condition() and time.monotonic() < ends_s:
        time.sleep(0.02)
    return bool(condition())


def measure(size_px: tuple[int, int], seconds: float, rate_hz: float, *, jpeg: bool, poses: bool) -> str:
    """Return a row of the table for images of one size."""
    topic = "camera/image_raw" + ("/compressed" if jpeg else "")
    rng = np.random.default_rng(0)
    images = [draw(number, size_px, rng) for number in range(round(seconds * rate_hz))]
    with router() as (session, port):
        peer = Peer(session, topic)
        kind = "sensor_msgs/msg/" + ("CompressedImage" if jpeg else "Image")
        peer.announce(topic, kind)
        peer.listen("skyherd/detections", DETECTIONS)
        counts: dict[int, int] = {}
        others = [
            session.declare_subscriber(
                peer.key(f"skyherd/marker_{marker}/pose", POSE),
                lambda sample, marker=marker: counts.update({marker: counts.get(marker, 0) + 1}),
            )
            for marker in IDS
        ]
        command = [sys.executable, "-m", "skyherd", "ros2", f"ros2://127.0.0.1:{port}/{topic}"]
        command += ["--marker-side-m", "0.08"] if poses else []
        info = peer.camera_info(*size_px, 1.2 * size_px[0]) if poses else None
        with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as bridge:

            def ready() -> bool:
                if info is not None:
                    peer.put("camera/camera_info", info)
                peer.put(topic, peer.image(images[0], time.time_ns(), jpeg=jpeg))
                time.sleep(0.1)
                return bool(peer.received)

            assert wait_for(ready, 60.0), "no detections within a minute"
            time.sleep(1.0)
            peer.received.clear()
            counts.clear()
            sent = stream(peer, images, rate_hz, jpeg=jpeg, info=info)
            wait_for(lambda: len(peer.received) >= len(sent), 3.0)
            time.sleep(0.3)
            bridge.terminate()
        del others
    got = [stamp for stamp in sent if stamp in peer.received]
    latencies_ms = [1000 * (peer.received[stamp][0] - sent[stamp]) for stamp in got]
    complete = sum(len(peer.received[stamp][1].detections) == len(IDS) for stamp in got)
    median, high, worst = np.percentile(latencies_ms, [50, 95, 100])
    name = f"{size_px[0]}x{size_px[1]}, {'JPEG' if jpeg else 'mono8'}{', with poses' if poses else ''}"
    whole = f"{len(sent)} | {len(sent) - len(got)} | {complete} | {sum(counts.values()) if poses else '–'}"
    return f"| {name} | {whole} | {median:.1f} | {high:.1f} | {worst:.1f} |"


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seconds", type=float, default=10.0, help="of each row")
    parser.add_argument("--rate", type=float, default=30.0, help="images a second")
    given = parser.parse_args()
    print("| images | sent | lost | with all 4 markers | poses | median, ms | 95 %, ms | longest, ms |")
    print("|---" * 8 + "|")
    for size_px, jpeg, poses in (
        ((640, 480), False, False),
        ((1280, 960), False, False),
        ((1280, 960), True, False),
        ((640, 480), False, True),
    ):
        print(measure(size_px, given.seconds, given.rate, jpeg=jpeg, poses=poses), flush=True)


if __name__ == "__main__":
    run(main)
