"""`skyherd ros2` between a Zenoh router and a peer that writes and reads by `rosbags`."""

import threading
import time
from contextlib import closing, contextmanager
from dataclasses import replace
from itertools import count
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

pytest.importorskip("zenoh")
pytest.importorskip("rosbags")

from skyherd.errors import InputError
from skyherd.files.images import Grey
from skyherd.live.cameras import Origin, open_camera
from skyherd.live.ros2.bridge import Bridge, BridgeSettings
from skyherd.live.ros2.names import Place
from skyherd.live.ros2.publishing import MarkerPublisher, poses_of
from skyherd.markers.dictionary import marker_cells
from skyherd.poses import Calibration
from skyherd.recording.ros_messages import RosMessages
from skyherd.vision import create_detector

SIZE_PX = (640, 480)
"""Width and height of the images."""

SIDE_M = 0.08
"""Side of the markers."""


@pytest.fixture(scope="module")
def script(load_benchmark):
    """Return the script with the peer."""
    return load_benchmark("ros_bridge")


@pytest.fixture(scope="module")
def images(script) -> list[Grey]:
    """Thirty images of four moving markers."""
    rng = np.random.default_rng(1)
    return [script.draw(number, SIZE_PX, rng) for number in range(30)]


@contextmanager
def bridged(script, topic="camera/image_raw", **settings):
    """Run a bridge in a thread, and provide its peer, itself and its problems."""
    with script.router() as (session, port):
        peer = script.Peer(session, topic)
        told: list[str] = []
        with closing(Bridge(BridgeSettings(f"ros2://127.0.0.1:{port}/{topic}", **settings))) as bridge:
            ended = threading.Event()
            thread = threading.Thread(target=bridge.run, args=[ended.is_set, told.append])
            thread.start()
            try:
                yield peer, bridge, told
            finally:
                ended.set()
                thread.join()


def connect(script, peer, image: Grey, *, jpeg: bool = False) -> list[int]:
    """Send images until one comes back, and return the list of the stamps, ns, that come from then on.

    Tokens may be seen before the subscribers behind them, and what is published in between is lost.
    """
    peer.listen("skyherd/detections", script.DETECTIONS)
    sent_ns = []

    def comes() -> bool:
        sent_ns.append(10**6 * (len(sent_ns) + 1))
        peer.put(peer.topic, peer.image(image, sent_ns[-1], jpeg=jpeg))
        time.sleep(0.1)
        return bool(peer.stamps_ns)

    assert script.wait_for(comes)
    # What was sent after the first that came back may still be on its way.
    assert script.wait_for(lambda: sent_ns[-1] in peer.stamps_ns)
    peer.received.clear()
    peer.stamps_ns.clear()
    return peer.stamps_ns


def marker_tokens(peer) -> set[tuple[str, str]]:
    """Return role and topic of the bridge's tokens."""
    alive = [str(reply.ok.key_expr).split("/") for reply in peer.session.liveliness().get("@ros2_lv/0/**")]
    return {(parts[5], parts[9]) for parts in alive if len(parts) == 13}


@pytest.mark.parametrize(
    "jpeg", [False, pytest.param(True, marks=pytest.mark.slow)], ids=["raw", "compressed"]
)
def test_thirty_images_a_second_come_back_without_loss(script, images, jpeg) -> None:
    topic = "camera/image_raw" + ("/compressed" if jpeg else "")
    with bridged(script, topic) as (peer, bridge, _):
        connect(script, peer, images[0], jpeg=jpeg)
        expected = {("MS", "%" + topic.replace("/", "%"))} | {
            ("MP", f"%skyherd%{name}") for name in ("detections", "tags")
        }
        assert script.wait_for(lambda: marker_tokens(peer) == expected)
        sent = script.stream(peer, images, 30.0, jpeg=jpeg)
        assert script.wait_for(lambda: len(peer.received) == len(sent), 5.0)
        assert bridge.dropped == 0
        for number, stamp in enumerate(sent):
            _, message = peer.received[stamp]
            assert message.header.frame_id == "optical_frame"
            found = {int(one.id): one for one in message.detections}
            assert sorted(found) == sorted(script.IDS)
            places = [(found[i].bbox.center.position.x, found[i].bbox.center.position.y) for i in script.IDS]
            # Five standard deviations, which the message states; OpenCV draws at multiples of 1/32 px; JPEG
            # adds at most 0.1 px.
            pose = found[script.IDS[0]].results[0].pose
            bound_px = 5 * np.sqrt(pose.covariance[0]) + 1 / 64 + 0.1 * jpeg
            assert 0 < bound_px < 0.5
            np.testing.assert_allclose(places, script.centers_px(number, SIZE_PX), atol=bound_px)


def test_poses_and_transforms_match_the_drawn_scene(script, images) -> None:
    """A pinhole camera looks straight at the markers, whose depth is the focal length per pixel of side."""
    focal_px, side_px = 700.0, 6 * script.CELL_PX
    poses, transforms = {}, {}
    with bridged(script, side_m=SIDE_M, one_plane=True) as (peer, _, told):

        def hear(topic: str, kind: str, take) -> object:
            """Subscribe to a topic, and give its messages to a function."""
            return peer.session.declare_subscriber(
                peer.key(topic, kind),
                lambda sample: take(peer.store.deserialize_cdr(bytes(sample.payload), kind)),
            )

        def stamp_ns(header) -> int:
            return header.stamp.sec * 10**9 + header.stamp.nanosec

        heard = [
            hear(
                "tf",
                "tf2_msgs/msg/TFMessage",
                lambda message: transforms.update({stamp_ns(message.transforms[0].header): message}),
            ),
            hear(
                "skyherd/marker_21/pose",
                script.POSE,
                lambda message: poses.update({stamp_ns(message.header): message}),
            ),
        ]
        stamps_ns = count(10**6, 10**6)

        def send(image: Grey, info=None) -> int:
            """Send an image after its calibration, and return its stamp, ns."""
            if info is not None:
                peer.put("camera/camera_info", info)
            stamp_ns = next(stamps_ns)
            peer.put(peer.topic, peer.image(image, stamp_ns))
            time.sleep(0.1)
            return stamp_ns

        # The calibration of another topic may arrive after the image, so that one more is sent.
        def is_told(words: str) -> bool:
            send(images[0])
            return any(words in one for one in told)

        def has_pose(image: Grey, sent_ns: list[int]) -> bool:
            sent_ns.append(send(image, info))
            return any(stamp in poses and stamp in transforms for stamp in sent_ns)

        assert script.wait_for(lambda: is_told("no poses: no message on /camera/camera_info"))
        info = peer.camera_info(*SIZE_PX, focal_px)
        bad = peer.camera_info(*SIZE_PX, 0.0)
        peer.put("camera/camera_info", bad)
        assert script.wait_for(lambda: is_told("the camera is not calibrated"))
        sent_ns = [[], [], []]
        for number, stamps in enumerate(sent_ns):
            assert script.wait_for(lambda number=number, stamps=stamps: has_pose(images[number], stamps))
        del heard
    depth_m = focal_px * SIDE_M / side_px
    for number, stamps in enumerate(sent_ns):
        stamp = next(stamp for stamp in stamps if stamp in poses and stamp in transforms)
        pose, transform = poses[stamp], transforms[stamp]
        row = script.IDS.index(21)
        aside = (script.centers_px(number, SIZE_PX)[row] - (np.array(SIZE_PX) - 1) / 2) / focal_px * depth_m
        place = pose.pose.pose.position
        stds = np.sqrt(np.diag(pose.pose.covariance.reshape(6, 6)))
        off = np.array([place.x, place.y, place.z]) - [*aside, depth_m]
        assert (np.abs(off) < 5 * stds[:3]).all() and stds[:3].max() < 0.02 * depth_m
        # Forward is up in the image, and out of the marker is towards the camera.
        turn = pose.pose.pose.orientation
        axes = Rotation.from_quat([turn.x, turn.y, turn.z, turn.w]).as_matrix()
        np.testing.assert_allclose(axes, [[0, -1, 0], [-1, 0, 0], [0, 0, -1]], atol=5 * stds[3:].max())
        (same,) = [one for one in transform.transforms if one.child_frame_id == "marker_21"]
        assert same.transform.translation.z == place.z and same.header.frame_id == "optical_frame"
        assert len(transform.transforms) == 4


def test_repeated_late_and_damaged_images_give_no_detections(script, images) -> None:
    with bridged(script) as (peer, _, _):
        stamps_ns = connect(script, peer, images[0])
        good = [peer.image(image, 10**9 * (5 + number)) for number, image in enumerate(images[:3])]
        cut = peer.image(images[3], 10**9 * 20)
        cut.data = cut.data[:-1]
        for number in (0, 2):
            peer.put(peer.topic, good[number])
            assert script.wait_for(lambda number=number: 10**9 * (5 + number) in stamps_ns)
        for message in (good[1], good[2], cut):
            peer.put(peer.topic, message)
            time.sleep(0.05)
        peer.session.put(peer.key(peer.topic, "sensor_msgs/msg/Image"), b"\x00\x01\x00\x00short")
        last = peer.image(images[4], 10**9 * 30)
        peer.put(peer.topic, last)
        assert script.wait_for(lambda: 10**9 * 30 in stamps_ns)
        assert stamps_ns == [10**9 * second for second in (5, 7, 30)]


def test_silent_topic_is_told_with_those_that_are_published(script, monkeypatch) -> None:
    monkeypatch.setattr("skyherd.live.cameras.ros2.READ_S", 0.2)
    with script.router() as (session, port):
        peer = script.Peer(session)
        peer.announce("other/image", "sensor_msgs/msg/Image")
        with open_camera(f"ros2://127.0.0.1:{port}/camera/image_raw") as reader:
            reason = "no publisher of /camera/image_raw; domain 0 has image topics: /other/image"
            assert script.wait_for(lambda: reason in (reader.trouble or ""), 5.0)
        peer.announce("camera/image_raw", "sensor_msgs/msg/CompressedImage")
        with open_camera(f"ros2://127.0.0.1:{port}/camera/image_raw") as reader:
            reason = "the topic has type sensor_msgs/msg/CompressedImage"
            assert script.wait_for(lambda: reason in (reader.trouble or ""), 5.0)


def test_lab_camera_takes_images_and_times_of_a_topic(script, images) -> None:
    with script.router() as (session, port):
        peer = script.Peer(session)
        with open_camera(f"ros2://127.0.0.1:{port}/camera/image_raw") as reader:
            assert script.wait_for(lambda: ("MS", "%camera%image_raw") in marker_tokens(peer))
            sent = script.stream(peer, images[:10], 30.0)
            frame = reader.newest(2.0)
            assert frame is not None and frame.stamped_by == "stream"
            assert frame.origin is not None and frame.origin.frame == "optical_frame"
            number = list(sent).index(frame.origin.stamp_ns)
            np.testing.assert_array_equal(frame.image, images[number])
            # The time of capture is estimated, and no later than the arrival.
            assert frame.captured_s <= frame.arrived_s < sent[frame.origin.stamp_ns] + 1.0


def test_images_without_a_stamp_get_the_time_of_arrival(script, images) -> None:
    with bridged(script) as (peer, _, _):
        connect(script, peer, images[0])
        before_ns = time.time_ns()
        peer.put(peer.topic, peer.image(images[0], 0))
        assert script.wait_for(lambda: bool(peer.received))
        (stamp_ns,) = peer.received
        assert before_ns < stamp_ns < time.time_ns()


def test_published_covariance_includes_the_mirror_image(monkeypatch, images) -> None:
    sent = []

    class Node:
        def __init__(self, place, where) -> None:
            pass

        def advertise(self, topic, quality):
            return SimpleNamespace(put=lambda data, stamp_ns: sent.append((topic.kind, data)))

    monkeypatch.setattr("skyherd.live.ros2.publishing.RosNode", Node)
    found = create_detector("photometric", dictionary="4X4_50").detect(images[0])
    calibration = Calibration(SIZE_PX, np.array([[700, 0, 319.5], [0, 700, 239.5], [0, 0, 1]]), np.zeros(0))
    poses = poses_of(images[0], found, "4X4_50", calibration, SIDE_M, one_plane=False)
    # As if both solutions were equally likely.
    poses = poses._replace(alone=replace(poses.alone, log_ratios=np.zeros(4)))
    MarkerPublisher(Place(), "skyherd", "test").publish_poses(Origin(1, "camera"), found, poses)
    kind = "geometry_msgs/msg/PoseWithCovarianceStamped"
    store = RosMessages("test").store
    stated = [store.deserialize_cdr(data, kind).pose.covariance for one, data in sent if one == kind]
    np.testing.assert_array_equal(np.reshape(stated, (-1, 6, 6)), poses.total_covariances())
    assert (poses.total_covariances()[:, 3, 3] > 10 * poses.covariances[:, 3, 3]).all()


@pytest.mark.slow
def test_restarted_router_loses_the_bridge_for_some_seconds_only(script, images) -> None:
    with script.router() as (session, port):
        peer = script.Peer(session)
        bridge = Bridge(BridgeSettings(f"ros2://127.0.0.1:{port}/camera/image_raw"))
    ended = threading.Event()
    thread = threading.Thread(target=bridge.run, args=[ended.is_set, lambda problem: None])
    thread.start()
    try:
        for _ in range(2):
            with script.router(port) as (session, _):
                peer = script.Peer(session)
                peer.listen("skyherd/detections", script.DETECTIONS)

                def comes(peer=peer) -> bool:
                    peer.put(peer.topic, peer.image(images[0], time.time_ns()))
                    return bool(peer.received)

                assert script.wait_for(comes, 15.0)
    finally:
        ended.set()
        thread.join()
        bridge.close()


class TestTags:
    def test_corners_and_homography_are_those_of_apriltag(self) -> None:
        """AprilTag 3 itself on a turned tag; its image coordinates are shifted by half a pixel."""
        library = pytest.importorskip("pupil_apriltags")
        cells = np.pad(marker_cells("APRILTAG_36h11", 7), 2, constant_values=True)
        card = np.kron(np.where(cells, 230, 30), np.ones((12, 12))).astype(np.uint8)
        warp = cv2.getRotationMatrix2D((72, 72), 25, 1.0)
        warp[:, 2] += 100, 80
        image = cv2.GaussianBlur(cv2.warpAffine(card, warp, (360, 320), borderValue=230), (0, 0), 0.8)
        (theirs,) = library.Detector(families="tag36h11", quad_decimate=1.0).detect(image)
        found = create_detector("photometric", dictionary="APRILTAG_36h11").detect(image)
        messages = RosMessages("test")
        tags = messages.tags(messages.header(1, "c"), found, "APRILTAG_36h11")
        tags = messages.store.deserialize_cdr(messages.data(tags), "apriltag_msgs/msg/AprilTagDetectionArray")
        (tag,) = tags.detections
        assert (tag.family, tag.id) == ("tag36h11", theirs.tag_id)
        corners = np.array([(corner.x, corner.y) for corner in tag.corners])
        np.testing.assert_allclose(corners, theirs.corners - 0.5, atol=0.5)
        for homography, shift in ((tag.homography.reshape(3, 3), 0.0), (theirs.homography, 0.5)):
            forward = homography @ [0.3, -0.7, 1.0]
            np.testing.assert_allclose(
                forward[:2] / forward[2] - shift, corner_mix(corners, 0.3, -0.7), atol=0.5
            )


def corner_mix(corners: np.ndarray, x: float, y: float) -> np.ndarray:
    """Return the point of a parallelogram at tag coordinates, from the corners of a tag."""
    middle = corners.mean(axis=0)
    right, down = (corners[1] - corners[0]) / 2, (corners[0] - corners[3]) / 2
    return middle + x * right + y * down


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        (BridgeSettings("0", side_m=0.08), "side_m: given without a calibration"),
        (BridgeSettings("0", to="mqtt://host/a"), "to: 'mqtt://host/a'; ros2://host:7447/namespace"),
        (BridgeSettings("0", to="ros2://host:77777/a"), "to: Port out of range"),
    ],
)
def test_invalid_settings_are_one_line(settings, said) -> None:
    with pytest.raises(InputError) as error:
        Bridge(settings)
    assert said in str(error.value) and "\n" not in str(error.value)
