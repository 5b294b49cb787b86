"""Keys, liveliness tokens and attachments of ROS 2 topics over Zenoh, compatible with `rmw_zenoh_cpp`.

Data go to the key expression

    <domain>/<topic>/<type>/<hash of the type>

with an attachment of 33 bytes: message number and time since 1970 in ns, 8 bytes each, little-endian; the
length 16; and 16 bytes that identify the publisher. Liveliness tokens announce node, publishers (MP) and
subscriptions (MS):

    @ros2_lv/<domain>/<session>/<node>/<node>/NN/%/<namespace>/<name>
    @ros2_lv/<domain>/<session>/<node>/<entity>/MP/%/<namespace>/<name>/<topic>/<type>/<hash>/<quality>

where `%` replaces the slashes of names. The id of a publisher is the XXH3 hash (128 bits) of its token. ROS 2
uses this form since Jazzy.
"""

import re
import struct
from dataclasses import dataclass
from typing import Literal
from urllib.parse import parse_qsl, urlsplit

from skyherd.errors import InputError

PORT = 7447
"""Default port of the router. *Defined* by Zenoh."""

NODE_ID = 0
"""Id of the node within its session, and of the first entity after it less one."""

GID_BYTES = 16
"""Length of a publisher's id, bytes. *Defined* by ROS 2."""

ATTACHMENT = struct.Struct("<qqB")
"""Number, time and the length of the id that follows. *Defined* by Zenoh's serialization."""

MAX_DOMAIN = 232
"""Largest ROS_DOMAIN_ID. *Defined* by ROS 2."""

NAME = re.compile(r"[A-Za-z_]\w*")
"""Pattern of one part of a ROS name."""

DEFAULT_DEPTH = 42
"""Depth of a history that a token leaves out. *Defined* by `rmw_zenoh_cpp`."""

TOKENS = "@ros2_lv/{domain}/**"
"""Key expression of all tokens of a domain."""


@dataclass(frozen=True)
class Quality:
    """Quality of service of a publisher or subscription: volatile, last messages kept.

    Attributes:
        depth: number of messages that are kept.
        reliable: False for best effort.
    """

    depth: int
    reliable: bool = True

    @property
    def text(self) -> str:
        """The quality in a token, in which empty fields are the defaults of `rmw_zenoh_cpp`."""
        depth = "" if self.depth == DEFAULT_DEPTH else self.depth
        return f"{'' if self.reliable else 2}::,{depth}:,:,:,,"


@dataclass(frozen=True)
class Place:
    """A domain of a ROS 2 graph, the router that leads to it, and the name of our node in it.

    Attributes:
        host: host of the router.
        port: its TCP port.
        domain: ROS_DOMAIN_ID.
        node: name of our node.
        config: file with a configuration of Zenoh, which replaces host and port; None without one.
    """

    host: str = "127.0.0.1"
    port: int = PORT
    domain: int = 0
    node: str = "skyherd"
    config: str | None = None

    def node_token(self, session: str) -> str:
        """Return the liveliness token of the node. `session` is the Zenoh id of our session."""
        return f"@ros2_lv/{self.domain}/{session}/{NODE_ID}/{NODE_ID}/NN/%/%/{self.node}"


@dataclass(frozen=True)
class Topic:
    """A topic and its type.

    Attributes:
        name: name with namespace, without a leading slash: `robot3/cmd_vel`.
        kind: its type, as `geometry_msgs/msg/Twist`.
        hash: hash of the type's definition (REP 2016), as `RIHS01_…`.
    """

    name: str
    kind: str
    hash: str

    @property
    def dds_name(self) -> str:
        """DDS name of the type."""
        package, _, name = self.kind.partition("/msg/")
        return f"{package}::msg::dds_::{name}_"

    def key(self, domain: int) -> str:
        """Return the key expression of the data."""
        return f"{domain}/{self.name}/{self.dds_name}/{self.hash}"

    def token(
        self, place: Place, session: str, entity: int, role: Literal["MP", "MS"], quality: Quality
    ) -> str:
        """Return the liveliness token of a publisher (MP) or subscription (MS).

        Args:
            place: domain and node.
            session: Zenoh id of our session.
            entity: its number within the session.
            role: which of the two it is.
            quality: its quality of service.
        """
        mangled = "%" + self.name.replace("/", "%")
        return (
            f"@ros2_lv/{place.domain}/{session}/{NODE_ID}/{entity}/{role}/%/%/{place.node}/"
            f"{mangled}/{self.dds_name}/{self.hash}/{quality.text}"
        )


def announced_topic(token: str) -> tuple[str, str, str] | None:
    """Return role, topic and type of the liveliness token of another node; None for a node's own token."""
    parts = token.split("/")
    if len(parts) != 13:
        return None
    package, _, name = parts[10].partition("::msg::dds_::")
    return parts[5], parts[9].replace("%", "/").lstrip("/"), f"{package}/msg/{name.removesuffix('_')}"


def attachment(number: int, stamp_ns: int, gid: bytes) -> bytes:
    """Return the attachment of message `number`, from 1: time, ns, and publisher id (16 bytes)."""
    return ATTACHMENT.pack(number, stamp_ns, GID_BYTES) + gid


def split_address(
    address: str, where: str, *, options: tuple[str, ...] = (), node: str
) -> tuple[Place, str, dict[str, str]]:
    """Return the place, the topic or namespace, and the further options of an address.

    The address has the form `ros2://host:7447/robot3/cmd_vel?domain=7&node=name&config=zenoh.json5`.

    Args:
        address: the address.
        where: its name in errors.
        options: names of further options.
        node: name of our node if the address has none.

    Raises:
        InputError: a name, number or option is invalid.
        ValueError: the port is invalid.
    """
    parts = urlsplit(address)
    given = dict(parse_qsl(parts.query, keep_blank_values=True))
    known = ("domain", "node", "config", *options)
    if unknown := sorted(set(given) - set(known)):
        raise InputError(where, f"option {unknown[0]!r}", f"of {', '.join(known)}")
    name, domain, node = parts.path.strip("/"), given.get("domain", "0"), given.get("node", node)
    if not all(NAME.fullmatch(part) for part in [*(name.split("/") if name else []), node]):
        raise InputError(where, f"topic {name!r}, node {node!r}", "letters, digits and _ between slashes")
    if not domain.isdecimal() or int(domain) > MAX_DOMAIN:
        raise InputError(where, f"domain {domain!r}", f"ROS_DOMAIN_ID, 0 to {MAX_DOMAIN}")
    place = Place(
        parts.hostname or "127.0.0.1", parts.port or PORT, int(domain), node, given.get("config") or None
    )
    return place, name, {key: value for key, value in given.items() if key in options}
