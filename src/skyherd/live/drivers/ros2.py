"""Twist and TwistStamped for ROS 2 over Zenoh, compatible with `rmw_zenoh_cpp`, without a ROS installation.

Data go to the key expression

    <domain>/<topic>/<type>/<hash of the type>

with an attachment of 33 bytes: message number and time since 1970 in ns, 8 bytes each, little-endian; the
length 16; and 16 bytes that identify the publisher. Two liveliness tokens announce node and publisher:

    @ros2_lv/<domain>/<session>/<node>/<node>/NN/%/<namespace>/<name>
    @ros2_lv/<domain>/<session>/<node>/<publisher>/MP/%/<namespace>/<name>/<topic>/<type>/<hash>/<quality>

where `%` replaces the slashes of names. ROS 2 uses this form since Jazzy.
"""

import json
import re
import secrets
import struct
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from urllib.parse import parse_qsl, urlsplit

from skyherd.errors import InputError
from skyherd.files.reading import read_text
from skyherd.live.drivers.cdr import twist, twist_stamped
from skyherd.live.drivers.link import Motion
from skyherd.plugins import import_extra

PORT = 7447
"""Default port of the router. *Defined* by Zenoh."""

HASHES = {
    "Twist": "RIHS01_9c45bf16fe0983d80e3cfe750d6835843d265a9a6c46bd2e609fcddde6fb8d2a",
    "TwistStamped": "RIHS01_5f0fcd4f81d5d06ad9b4c4c63e3ea51b82d6ae4d0558f1d475229b1121db6f64",
}
"""Hash of the definition of each type. *Derived* from geometry_msgs by REP 2016, as a test verifies."""

QUALITY = "::,1:,:,:,,"
"""Quality of service in the tokens: reliable, volatile, keep the last one. Empty fields are defaults.
*Chosen*: a robot needs only the newest command."""

NODE_ID, PUBLISHER_ID = 0, 1
"""Ids of the node and the publisher within their session."""

GID_BYTES = 16
"""Length of a publisher's id, bytes. *Defined* by ROS 2."""

CONNECT_MS = 4000
"""Timeout of the connection to the router, ms. *Chosen*."""

MAX_CONFIG_BYTES = 2**20
"""Size of the largest accepted Zenoh configuration, bytes. *Chosen*: far above any real one."""

NAME = re.compile(r"[A-Za-z_]\w*")
"""Pattern of one part of a ROS name."""

KEYS = ("type", "domain", "frame", "node", "config")
"""Options of an address, after its question mark."""


@dataclass(frozen=True)
class Topic:
    """A ROS 2 topic of twists.

    Attributes:
        name: name with namespace, without a leading slash: `robot3/cmd_vel`.
        kind: `Twist` or `TwistStamped`.
        domain: ROS_DOMAIN_ID.
        node: name of our node.
        frame: coordinate frame of stamped twists.
    """

    name: str
    kind: str = "Twist"
    domain: int = 0
    node: str = "skyherd"
    frame: str = "base_link"

    @property
    def type_name(self) -> str:
        """DDS name of the type."""
        return f"geometry_msgs::msg::dds_::{self.kind}_"

    @property
    def key(self) -> str:
        """Key expression of the data."""
        return f"{self.domain}/{self.name}/{self.type_name}/{HASHES[self.kind]}"

    def node_token(self, session: str) -> str:
        """Return the liveliness token of the node. `session` is the Zenoh id of our session."""
        return f"@ros2_lv/{self.domain}/{session}/{NODE_ID}/{NODE_ID}/NN/%/%/{self.node}"

    def publisher_token(self, session: str) -> str:
        """Return the liveliness token of the publisher."""
        mangled = "%" + self.name.replace("/", "%")
        return (
            f"@ros2_lv/{self.domain}/{session}/{NODE_ID}/{PUBLISHER_ID}/MP/%/%/{self.node}/"
            f"{mangled}/{self.type_name}/{HASHES[self.kind]}/{QUALITY}"
        )

    def message(self, motion: Motion, stamp_ns: int) -> bytes:
        """Return a motion as the topic's message, stamped with a time since 1970, ns."""
        return twist(motion) if self.kind == "Twist" else twist_stamped(motion, stamp_ns, self.frame)


def attachment(number: int, stamp_ns: int, gid: bytes) -> bytes:
    """Return the attachment of message `number`, from 1: time, ns, and publisher id (16 bytes)."""
    return struct.pack("<qqB", number, stamp_ns, GID_BYTES) + gid


def topic_of(address: str, robot_id: int) -> Topic:
    """Return the topic of an address.

    The address has the form
    `ros2://host:7447/robot3/cmd_vel?type=TwistStamped&domain=7&frame=base_link&node=name`.

    Raises:
        InputError: a name, number or type is invalid.
        ValueError: the port is invalid.
    """
    parts, where = urlsplit(address), f"driver {address}"
    options = dict(parse_qsl(parts.query, keep_blank_values=True))
    if unknown := sorted(set(options) - set(KEYS)):
        raise InputError(where, f"option {unknown[0]!r}", f"of {', '.join(KEYS)}")
    name, kind = parts.path.strip("/") or "cmd_vel", options.get("type", "Twist")
    _ = parts.port  # Raises ValueError for an invalid port.
    domain, node = options.get("domain", "0"), options.get("node", f"skyherd_robot_{robot_id}")
    if kind not in HASHES:
        raise InputError(where, f"type {kind!r}", "Twist or TwistStamped")
    if not all(NAME.fullmatch(part) for part in [*name.split("/"), node]):
        raise InputError(where, f"topic {name!r}, node {node!r}", "letters, digits and _ between slashes")
    if not domain.isdecimal() or int(domain) > 232:
        raise InputError(where, f"domain {domain!r}", "ROS_DOMAIN_ID, 0 to 232")
    return Topic(name, kind, int(domain), node, options.get("frame", "base_link"))


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
        self.topic = topic_of(address, robot_id)
        where = f"driver {address}"
        self._zenoh = import_extra("zenoh", "eclipse-zenoh", where, "live")
        try:
            self._session = self._zenoh.open(self._configuration(address))
        except InputError:
            raise
        except Exception as error:  # Zenoh's error class derives directly from Exception.
            words = " ".join(str(error).split()) or "no answer"
            raise InputError(where, f"no router of Zenoh: {words}", "start rmw_zenohd there") from None
        session, alive = str(self._session.zid()), self._session.liveliness()
        self._publisher = self._session.declare_publisher(
            self.topic.key, congestion_control=self._zenoh.CongestionControl.DROP, express=True
        )
        self._tokens = [
            alive.declare_token(self.topic.node_token(session)),
            alive.declare_token(self.topic.publisher_token(session)),
        ]
        self._gid, self._number = secrets.token_bytes(GID_BYTES), 0

    def _configuration(self, address: str) -> Any:
        """Return the Zenoh configuration of a client of one router, without scouting."""
        parts = urlsplit(address)
        file = dict(parse_qsl(parts.query)).get("config")
        if file:
            text = read_text(Path(file), "a configuration of Zenoh, JSON5", MAX_CONFIG_BYTES)
            return self._zenoh.Config.from_json5(text)
        host = parts.hostname or "127.0.0.1"
        host = f"[{host}]" if ":" in host else host
        configuration = self._zenoh.Config()
        for key, value in {
            "mode": "client",
            "connect/endpoints": [f"tcp/{host}:{parts.port or PORT}"],
            "connect/timeout_ms": CONNECT_MS,
            "connect/exit_on_failure": True,
            "scouting/multicast/enabled": False,
        }.items():
            configuration.insert_json5(key, json.dumps(value))
        return configuration

    def write(self, motion: Motion) -> None:
        """Publish a motion; see `Link.write`."""
        stamp_ns = self._now_ns()
        self._number += 1
        try:
            self._publisher.put(
                self.topic.message(motion, stamp_ns), attachment=attachment(self._number, stamp_ns, self._gid)
            )
        except Exception as error:  # Zenoh's error class derives directly from Exception.
            raise OSError(" ".join(str(error).split())) from None

    def close(self) -> None:
        """Withdraw the tokens and close the session; see `Link.close`."""
        for token in self._tokens:
            token.undeclare()
        self._publisher.undeclare()
        self._session.close()
