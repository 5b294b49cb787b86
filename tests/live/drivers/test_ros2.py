"""Twists for ROS 2: bytes against `rosbags`, keys and tokens against `rmw_zenoh_cpp`."""

import socket
import struct
import time

import numpy as np
import pytest

from skyherd.errors import InputError
from skyherd.live.drivers import STILL, Motion
from skyherd.live.drivers.cdr import twist, twist_stamped
from skyherd.live.drivers.ros2 import HASHES, NEWEST, Ros2, topic_of
from skyherd.live.ros2.names import Place, attachment

MOTION = Motion(0.125, -0.75, left_mps=0.5, up_mps=-2.0)
STAMP_NS = 1_700_000_000_987_654_321


@pytest.fixture(scope="module")
def store():
    """Return the message types of ROS 2 Jazzy from an independent implementation."""
    typesys = pytest.importorskip("rosbags.typesys")
    return typesys.get_typestore(typesys.Stores.ROS2_JAZZY)


def velocities(message) -> list[float]:
    return [getattr(part, axis) for part in (message.linear, message.angular) for axis in "xyz"]


def test_key_and_tokens_have_the_parts_of_rmw_zenoh() -> None:
    place, topic, frame = topic_of(
        "ros2://host:7447/robot3/cmd_vel?type=TwistStamped&domain=7&node=herder", 3
    )
    assert (
        topic.key(7) == f"7/robot3/cmd_vel/geometry_msgs::msg::dds_::TwistStamped_/{HASHES['TwistStamped']}"
    )
    assert place.node_token("c0ffee") == "@ros2_lv/7/c0ffee/0/0/NN/%/%/herder"
    assert topic.token(place, "c0ffee", 1, "MP", NEWEST) == (
        "@ros2_lv/7/c0ffee/0/1/MP/%/%/herder/%robot3%cmd_vel/"
        f"geometry_msgs::msg::dds_::TwistStamped_/{HASHES['TwistStamped']}/::,1:,:,:,,"
    )
    assert (place.domain, frame) == (7, "base_link")
    place, topic, frame = topic_of("ros2://host", 3)
    assert (place, topic.name, topic.kind, frame) == (
        Place("host", node="skyherd_robot_3"),
        "cmd_vel",
        "geometry_msgs/msg/Twist",
        None,
    )


def tokens(robot, count: int) -> set[str]:
    """Wait for a number of liveliness tokens, and return their kinds."""
    for _ in range(1000):
        alive = [str(reply.ok.key_expr) for reply in robot.liveliness().get("@ros2_lv/0/**")]
        if len(alive) == count:
            break
        time.sleep(0.01)
    return {token.split("/")[5] for token in alive}


def test_subscriber_receives_twists_and_sees_node() -> None:
    """A Zenoh router and a subscriber like that of a robot's node run on loopback."""
    zenoh = pytest.importorskip("zenoh")
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    configuration = zenoh.Config()
    for key, value in {
        "mode": '"router"',
        "listen/endpoints": f'["tcp/127.0.0.1:{port}"]',
        "scouting/multicast/enabled": "false",
    }.items():
        configuration.insert_json5(key, value)
    with zenoh.open(configuration) as robot:
        heard = robot.declare_subscriber(topic_of("ros2:///robot3/cmd_vel?type=TwistStamped", 3).topic.key(0))
        link = Ros2(f"ros2://127.0.0.1:{port}/robot3/cmd_vel?type=TwistStamped", 3, now_ns=lambda: STAMP_NS)
        try:
            assert tokens(robot, 2) == {"NN", "MP"}
            alive = [str(reply.ok.key_expr) for reply in robot.liveliness().get("@ros2_lv/0/*/*/*/MP/**")]
            hashed = pytest.importorskip("xxhash").xxh3_128_intdigest(alive[0].encode())
            gid = struct.pack("<QQ", hashed % 2**64, hashed >> 64)
            for motion in (MOTION, STILL):
                link.write(motion)
            for number, motion in enumerate((MOTION, STILL), start=1):
                sample = heard.recv()
                assert bytes(sample.payload) == twist_stamped(motion, STAMP_NS, "base_link")
                assert struct.unpack("<qqB", bytes(sample.attachment)[:17]) == (number, STAMP_NS, 16)
                assert bytes(sample.attachment)[17:] == gid
        finally:
            link.close()
        assert tokens(robot, 0) == set()


def test_absent_router_is_one_clear_line(monkeypatch) -> None:
    pytest.importorskip("zenoh")
    monkeypatch.setattr("skyherd.live.ros2.session.CONNECT_MS", 200)
    with pytest.raises(InputError, match=r"no router of Zenoh: .*Timeout!; start rmw_zenohd"):
        Ros2("ros2://127.0.0.1:1/cmd_vel", 0)


class TestSerialization:
    def test_rosbags_reads_twist(self, store) -> None:
        data = twist(MOTION)
        message = store.deserialize_cdr(data, "geometry_msgs/msg/Twist")
        assert velocities(message) == [0.125, 0.5, -2.0, 0.0, 0.0, -0.75]
        assert bytes(store.serialize_cdr(message, "geometry_msgs/msg/Twist")) == data

    @pytest.mark.parametrize("length", range(9))
    def test_rosbags_reads_twist_stamped_with_any_padding(self, store, length) -> None:
        frame = "base_link_"[:length]
        data = twist_stamped(MOTION, STAMP_NS, frame)
        message = store.deserialize_cdr(data, "geometry_msgs/msg/TwistStamped")
        stamp = message.header.stamp
        assert (stamp.sec, stamp.nanosec, message.header.frame_id) == (1_700_000_000, 987_654_321, frame)
        assert velocities(message.twist) == [0.125, 0.5, -2.0, 0.0, 0.0, -0.75]
        assert bytes(store.serialize_cdr(message, "geometry_msgs/msg/TwistStamped")) == data

    @pytest.mark.parametrize("kind", HASHES)
    def test_hashes_match_the_definitions(self, store, kind) -> None:
        assert store.hash_rihs01(f"geometry_msgs/msg/{kind}") == HASHES[kind]

    def test_attachment_matches_zenoh_serialization(self) -> None:
        ext = pytest.importorskip("zenoh.ext")
        gid = bytes(range(16))
        data = attachment(7, STAMP_NS, gid)
        assert len(data) == 33
        parts = [ext.z_serialize(ext.Int64(7)), ext.z_serialize(ext.Int64(STAMP_NS)), ext.z_serialize(gid)]
        assert data == b"".join(bytes(part) for part in parts)

    def test_numbers_round_trip_exactly(self, store) -> None:
        values = np.random.default_rng(0).normal(size=(50, 4)) * 10.0 ** np.arange(-8, 8, 4)
        for row in values.tolist():
            message = store.deserialize_cdr(twist(Motion(*row)), "geometry_msgs/msg/Twist")
            assert (message.linear.x, message.angular.z, message.linear.y, message.linear.z) == tuple(row)
