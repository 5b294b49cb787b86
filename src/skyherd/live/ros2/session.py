"""A node in the graph of ROS 2: a Zenoh session with its publishers, subscriptions and tokens."""

import json
import re
from collections.abc import Callable
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from skyherd.errors import InputError
from skyherd.files.reading import read_text
from skyherd.live.ros2.names import (
    NODE_ID,
    TOKENS,
    Place,
    Quality,
    Topic,
    announced_topic,
    attachment,
)
from skyherd.plugins import import_extra

CONNECT_MS = 4000
"""Timeout of the connection to the router, ms. *Chosen*."""

ASK_S = 1.0
"""Timeout of a query for tokens, s. *Chosen*: routers answer within milliseconds."""

WAITING_BATCHES, MAX_WAIT_US = 16, 50_000
"""Batches that wait to be sent, and the longest wait for a free one before a message is dropped, µs. Zenoh's
defaults, 2 and 1000, drop some of the messages of an image if the machine is busy. *Chosen*: the largest
number; a command is then late by at most the interval of commands."""

MAX_CONFIG_BYTES = 2**20
"""Size of the largest accepted Zenoh configuration, bytes. *Chosen*: far above any real one."""


class Publisher:
    """Publisher of serialized messages. Messages that cannot be sent at once are dropped.

    Args:
        declared: Zenoh's publisher.
        gid: its id, 16 bytes.
    """

    def __init__(self, declared: Any, gid: bytes) -> None:
        self._declared, self._gid, self._number = declared, gid, 0

    def put(self, data: bytes, stamp_ns: int) -> None:
        """Publish a message in CDR, with a time since 1970, ns.

        Raises:
            OSError: the session is closed.
        """
        self._number += 1
        try:
            self._declared.put(data, attachment=attachment(self._number, stamp_ns, self._gid))
        except Exception as error:  # Zenoh's error class derives directly from Exception.
            raise OSError(" ".join(str(error).split())) from None


class RosNode:
    """Node of ROS 2 at a Zenoh router, without a ROS installation.

    Args:
        place: router, domain and name.
        where: its address, for errors.

    Raises:
        InputError: the router does not answer, the configuration is invalid, or a library is missing.
    """

    def __init__(self, place: Place, where: str) -> None:
        self.place = place
        self._zenoh = import_extra("zenoh", "eclipse-zenoh", where, "live")
        self._xxhash = import_extra("xxhash", "xxhash", where, "live")
        try:
            self._session = self._zenoh.open(self._configuration())
        except InputError:
            raise
        except Exception as error:  # Zenoh's error class derives directly from Exception.
            # The library appends places in its own source: `… at /root/…/orchestrator.rs:388.`
            words = re.sub(r" at /\S+\.rs:\d+\.?", "", " ".join(str(error).split())) or "no answer"
            raise InputError(where, f"no router of Zenoh: {words}", "start rmw_zenohd there") from None
        self._id, self._entities = str(self._session.zid()), NODE_ID
        self._declared: list[Any] = [self._declare_token(place.node_token(self._id))]

    def _configuration(self) -> Any:
        """Return the Zenoh configuration of a client of one router, without scouting."""
        place = self.place
        if place.config:
            text = read_text(Path(place.config), "a configuration of Zenoh, JSON5", MAX_CONFIG_BYTES)
            return self._zenoh.Config.from_json5(text)
        host = f"[{place.host}]" if ":" in place.host else place.host
        configuration = self._zenoh.Config()
        for key, value in {
            "mode": "client",
            "connect/endpoints": [f"tcp/{host}:{place.port}"],
            "connect/timeout_ms": CONNECT_MS,
            "connect/exit_on_failure": True,
            "scouting/multicast/enabled": False,
            "transport/link/tx/queue/size/data": WAITING_BATCHES,
            "transport/link/tx/queue/congestion_control/drop/wait_before_drop": MAX_WAIT_US,
        }.items():
            configuration.insert_json5(key, json.dumps(value))
        return configuration

    def _declare_token(self, token: str) -> Any:
        return self._session.liveliness().declare_token(token)

    def advertise(self, topic: Topic, quality: Quality) -> Publisher:
        """Declare and return a publisher, and its token."""
        self._entities += 1
        token = topic.token(self.place, self._id, self._entities, "MP", quality)
        reliability = self._zenoh.Reliability
        declared = self._session.declare_publisher(
            topic.key(self.place.domain),
            congestion_control=self._zenoh.CongestionControl.DROP,
            reliability=reliability.RELIABLE if quality.reliable else reliability.BEST_EFFORT,
            express=True,
        )
        self._declared += [declared, self._declare_token(token)]
        return Publisher(declared, self._xxhash.xxh3_128_digest(token.encode())[::-1])

    def subscribe(self, topic: Topic, quality: Quality, take: Callable[[bytes], None]) -> None:
        """Declare a subscription and its token. `take` is called in a thread of Zenoh with each message."""
        self._entities += 1
        declared = self._session.declare_subscriber(
            topic.key(self.place.domain), lambda sample: take(bytes(sample.payload))
        )
        token = topic.token(self.place, self._id, self._entities, "MS", quality)
        self._declared += [declared, self._declare_token(token)]

    def published_topics(self) -> dict[str, set[str]]:
        """Return the types of the topics that nodes of the domain publish, by name without leading slash."""
        found: dict[str, set[str]] = {}
        replies = self._session.liveliness().get(TOKENS.format(domain=self.place.domain), timeout=ASK_S)
        for reply in replies:
            announced = None if reply.ok is None else announced_topic(str(reply.ok.key_expr))
            if announced is not None and announced[0] == "MP":
                found.setdefault(announced[1], set()).add(announced[2])
        return found

    def close(self) -> None:
        """Withdraw tokens, publishers and subscriptions, and close the session."""
        for declared in reversed(self._declared):
            declared.undeclare()
        self._session.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()
