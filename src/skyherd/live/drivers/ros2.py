"""Twist and TwistStamped for ROS 2, over Zenoh as `rmw_zenoh_cpp` speaks it, without an installation of ROS.

Data go to the key expression

    <domain>/<topic>/<type>/<hash of the type>

with an attachment of 33 bytes: number of the message and time since 1970 in ns, 8 bytes each, little-endian;
the length 16; and 16 bytes that identify the publisher. Two liveliness tokens tell ROS of node and publisher:

    @ros2_lv/<domain>/<session>/<node>/<node>/NN/%/<namespace>/<name>
    @ros2_lv/<domain>/<session>/<node>/<publisher>/MP/%/<namespace>/<name>/<topic>/<type>/<hash>/<quality>

in which slashes of names are written as `%`. This is the form since ROS 2 Jazzy.
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
from skyherd.live.drivers.extras import import_extra
from skyherd.live.drivers.link import Motion

PORT = 7447
"""The router's port where none is named. *Defined* by Zenoh."""

HASHES = {
    "Twist": "RIHS01_9c45bf16fe0983d80e3cfe750d6835843d265a9a6c46bd2e609fcddde6fb8d2a",
    "TwistStamped": "RIHS01_5f0fcd4f81d5d06ad9b4c4c63e3ea51b82d6ae4d0558f1d475229b1121db6f64",
}
"""By type, the hash of its definition. *Derived* from the definitions of geometry_msgs by REP 2016;
a test derives them again."""

QUALITY = "::,1:,:,:,,"
"""Quality of service as the tokens have it, what is empty being the default: reliable, volatile, keep the
last one. A robot is to know the newest command, and no other."""

NODE_ID, PUBLISHER_ID = 0, 1
"""Numbers of node and publisher in their session, which has no others."""

GID_BYTES = 16
"""Bytes that identify a publisher. *Defined* by ROS 2."""

CONNECT_MS = 4000
"""How long the router may take to answer at the start, ms. *Chosen*."""

MAX_CONFIG_BYTES = 2**20
"""Size of the largest configuration of Zenoh that is read. *Chosen*: far beyond any."""

NAME = re.compile(r"[A-Za-z_]\w*")
"""Part of a name in ROS."""

KEYS = ("type", "domain", "frame", "node", "config")
"""What may stand behind the question mark of an address."""


@dataclass(frozen=True)
class Topic:
    """A topic of ROS 2 that twists are published on.

    Attributes:
        name: with its namespace, without a leading slash: `robot3/cmd_vel`.
        kind: `Twist` or `TwistStamped`.
        domain: ROS_DOMAIN_ID.
        node: name of our node.
        frame: frame of stamped twists.
    """

    name: str
    kind: str = "Twist"
    domain: int = 0
    node: str = "skyherd"
    frame: str = "base_link"

    @property
    def type_name(self) -> str:
        """The type as DDS calls it."""
        return f"geometry_msgs::msg::dds_::{self.kind}_"

    @property
    def key(self) -> str:
        """Key expression of the data."""
        return f"{self.domain}/{self.name}/{self.type_name}/{HASHES[self.kind]}"

    def node_token(self, session: str) -> str:
        """Liveliness token of the node; `session` is Zenoh's id of our session."""
        return f"@ros2_lv/{self.domain}/{session}/{NODE_ID}/{NODE_ID}/NN/%/%/{self.node}"

    def publisher_token(self, session: str) -> str:
        """Liveliness token of the publisher."""
        mangled = "%" + self.name.replace("/", "%")
        return (
            f"@ros2_lv/{self.domain}/{session}/{NODE_ID}/{PUBLISHER_ID}/MP/%/%/{self.node}/"
            f"{mangled}/{self.type_name}/{HASHES[self.kind]}/{QUALITY}"
        )

    def message(self, motion: Motion, stamp_ns: int) -> bytes:
        """A motion as the topic's message, stamped with a time since 1970, ns."""
        return twist(motion) if self.kind == "Twist" else twist_stamped(motion, stamp_ns, self.frame)


def attachment(number: int, stamp_ns: int, gid: bytes) -> bytes:
    """What goes along with message `number`, from 1: the time, ns, and who published it (16 bytes)."""
    return struct.pack("<qqB", number, stamp_ns, GID_BYTES) + gid


def topic_of(address: str, robot_id: int) -> Topic:
    """The topic of `ros2://host:7447/robot3/cmd_vel?type=TwistStamped&domain=7&frame=base_link&node=name`.

    Raises:
        InputError: a name, number or type that cannot be.
        ValueError: the port is none.
    """
    parts, where = urlsplit(address), f"driver {address}"
    options = dict(parse_qsl(parts.query, keep_blank_values=True))
    if unknown := sorted(set(options) - set(KEYS)):
        raise InputError(where, f"option {unknown[0]!r}", f"of {', '.join(KEYS)}")
    name, kind = parts.path.strip("/") or "cmd_vel", options.get("type", "Twist")
    _ = parts.port  # which raises where it is none
    domain, node = options.get("domain", "0"), options.get("node", f"skyherd_robot_{robot_id}")
    if kind not in HASHES:
        raise InputError(where, f"type {kind!r}", "Twist or TwistStamped")
    if not all(NAME.fullmatch(part) for part in [*name.split("/"), node]):
        raise InputError(where, f"topic {name!r}, node {node!r}", "letters, digits and _ between slashes")
    if not domain.isdecimal() or int(domain) > 232:
        raise InputError(where, f"domain {domain!r}", "ROS_DOMAIN_ID, 0 to 232")
    return Topic(name, kind, int(domain), node, options.get("frame", "base_link"))


class Ros2:
    """Publishes twists for a robot with ROS 2.

    Args:
        address: see `topic_of`. The host is that of Zenoh's router (`ros2 run rmw_zenoh_cpp rmw_zenohd`),
            this machine if left out; `?config=zenoh.json5` reads Zenoh's own configuration, for TLS.
        robot_id: the robot.
        now_ns: gives the time since 1970, ns.

    Raises:
        InputError: the router does not answer, the address means nothing, or eclipse-zenoh is not installed.
    """

    def __init__(self, address: str, robot_id: int, now_ns: Callable[[], int] = time.time_ns) -> None:
        self.name, self._now_ns = address, now_ns
        self.topic = topic_of(address, robot_id)
        where = f"driver {address}"
        self._zenoh = import_extra("zenoh", "eclipse-zenoh", where)
        try:
            self._session = self._zenoh.open(self._configuration(address))
        except InputError:
            raise
        except Exception as error:  # Zenoh's own class, which derives from Exception alone
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
        """Zenoh's configuration: a client of one router, that searches nobody else."""
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
        """See `Link.write`."""
        stamp_ns = self._now_ns()
        self._number += 1
        try:
            self._publisher.put(
                self.topic.message(motion, stamp_ns), attachment=attachment(self._number, stamp_ns, self._gid)
            )
        except Exception as error:  # Zenoh's own class
            raise OSError(" ".join(str(error).split())) from None

    def close(self) -> None:
        """See `Link.close`."""
        for token in self._tokens:
            token.undeclare()
        self._publisher.undeclare()
        self._session.close()
