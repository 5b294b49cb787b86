"""Twist and TwistStamped for ROS 2 over Zenoh; `skyherd.live.ros2.names` has the keys and tokens."""

import time
from collections.abc import Callable
from typing import NamedTuple

from skyherd.errors import InputError
from skyherd.live.drivers.cdr import twist, twist_stamped
from skyherd.live.drivers.link import Motion
from skyherd.live.ros2.names import Place, Quality, Topic, split_address
from skyherd.live.ros2.session import RosNode

HASHES = {
    "Twist": "RIHS01_9c45bf16fe0983d80e3cfe750d6835843d265a9a6c46bd2e609fcddde6fb8d2a",
    "TwistStamped": "RIHS01_5f0fcd4f81d5d06ad9b4c4c63e3ea51b82d6ae4d0558f1d475229b1121db6f64",
}
"""Hash of the definition of each type. *Derived* from geometry_msgs by REP 2016, as a test verifies."""

NEWEST = Quality(depth=1)
"""Quality of service: reliable, only the last message kept. *Chosen*: older commands are stale."""


class TwistTopic(NamedTuple):
    """A topic of twists.

    Attributes:
        place: router, domain and node.
        topic: name and type.
        frame: coordinate frame of stamped twists; None for plain ones.
    """

    place: Place
    topic: Topic
    frame: str | None

    def message(self, motion: Motion, stamp_ns: int) -> bytes:
        """Return a motion as the topic's message, stamped with a time since 1970, ns."""
        return twist(motion) if self.frame is None else twist_stamped(motion, stamp_ns, self.frame)


def topic_of(address: str, robot_id: int) -> TwistTopic:
    """Return the topic of an address.

    The address has the form
    `ros2://host:7447/robot3/cmd_vel?type=TwistStamped&domain=7&frame=base_link&node=name`.

    Raises:
        InputError: a name, number or type is invalid.
        ValueError: the port is invalid.
    """
    where = f"driver {address}"
    place, name, options = split_address(
        address, where, options=("type", "frame"), node=f"skyherd_robot_{robot_id}"
    )
    kind = options.get("type", "Twist")
    if kind not in HASHES:
        raise InputError(where, f"type {kind!r}", "Twist or TwistStamped")
    topic = Topic(name or "cmd_vel", f"geometry_msgs/msg/{kind}", HASHES[kind])
    return TwistTopic(place, topic, options.get("frame", "base_link") if kind == "TwistStamped" else None)


class Ros2:
    """Link that publishes twists for a robot with ROS 2.

    Args:
        address: see `topic_of`. The host runs the Zenoh router (`ros2 run rmw_zenoh_cpp rmw_zenohd`); the
            default is this machine. `?config=zenoh.json5` reads a Zenoh configuration, for TLS.
        robot_id: the robot.
        now_ns: returns the time since 1970, ns.

    Raises:
        InputError: the router does not answer, the address is invalid, or eclipse-zenoh is not installed.
    """

    def __init__(self, address: str, robot_id: int, now_ns: Callable[[], int] = time.time_ns) -> None:
        self.name, self._now_ns = address, now_ns
        self._twists = topic_of(address, robot_id)
        self._node = RosNode(self._twists.place, f"driver {address}")
        self._publisher = self._node.advertise(self._twists.topic, NEWEST)

    def write(self, motion: Motion) -> None:
        """Publish a motion; see `Link.write`."""
        stamp_ns = self._now_ns()
        self._publisher.put(self._twists.message(motion, stamp_ns), stamp_ns)

    def close(self) -> None:
        """Withdraw the tokens and close the session; see `Link.close`."""
        self._node.close()
