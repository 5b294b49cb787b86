"""Radio over Zenoh: all processes are peers, without a broker or router."""

import json
import threading
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

from skyherd.errors import InputError
from skyherd.live.lab import LabRadio
from skyherd.live.local_peers import LocalPeers
from skyherd.live.mailbox import Radio
from skyherd.plugins import import_extra

RETRY_MS = 300
"""Interval of retries to listen and to connect, ms. Chosen: a new process may be without peers for this
time."""

CLOSE_S = 1.0
"""Timeout of `ZenohRadio.close`, s. Chosen: published messages are sent within milliseconds."""


class ZenohRadio(Radio):
    """Zenoh session in peer mode, without multicast scouting.

    Peers exchange the endpoints that they know, so each one needs to reach only one other. A process without
    the port of the lab file retries, and takes it over when it is free: no process is a single point of
    failure. It also retries to connect. Two processes that start together find no port open at first. Without
    TLS a process connects to others of its machine as well (`LocalPeers`), since the one that owns the port
    may be suspended.

    Args:
        places: endpoints to listen on and to connect to.
        folder: folder to which names of certificate files are relative.
        insecure: True allows endpoints beyond loopback without TLS and client certificates.

    Raises:
        InputError: Zenoh is not installed, an endpoint is not secured, or Zenoh refuses the endpoints.
    """

    def __init__(self, places: LabRadio, folder: Path, *, insecure: bool = False) -> None:
        places.check(insecure=insecure)
        zenoh = import_extra("zenoh", "eclipse-zenoh", "radio", "live")
        config = zenoh.Config()
        self._peers = LocalPeers([*places.listen, *places.connect]) if is_plain(places) else None
        own, others = ([self._peers.own], self._peers.others()) if self._peers else (tls_places(places), [])
        settings: dict[str, Any] = {
            "mode": "peer",
            "listen/endpoints": [*places.listen, *own],
            "listen/exit_on_failure": False,
            "listen/timeout_ms": -1,
            "listen/retry": {"period_init_ms": RETRY_MS, "period_max_ms": RETRY_MS},
            "connect/endpoints": [*places.connect, *others],
            "connect/exit_on_failure": False,
            "connect/timeout_ms": -1,
            "connect/retry": {"period_init_ms": RETRY_MS, "period_max_ms": RETRY_MS},
            "scouting/multicast/enabled": False,
            "transport/shared_memory/enabled": False,
        }
        if places.certificate and places.key and places.authority:  # all of `has_certificates`
            settings |= {
                "transport/link/tls/root_ca_certificate": str(folder / places.authority),
                "transport/link/tls/listen_certificate": str(folder / places.certificate),
                "transport/link/tls/listen_private_key": str(folder / places.key),
                "transport/link/tls/connect_certificate": str(folder / places.certificate),
                "transport/link/tls/connect_private_key": str(folder / places.key),
                "transport/link/tls/enable_mtls": True,
            }
        try:
            for key, value in settings.items():
                config.insert_json5(key, json.dumps(value))
            self._session = zenoh.open(config)
        except zenoh.ZError as error:
            what = " ".join(str(error).split())
            raise InputError("radio", what, "listen and connect as Zenoh writes them") from None
        if self._peers:
            self._peers.enter()
        self._error = zenoh.ZError
        self._drop = zenoh.CongestionControl.DROP
        self._subscribers: list[Any] = []

    def publish(self, topic: str, data: bytes) -> None:
        """Send bytes to all current subscribers. They are dropped where a connection is congested."""
        self._session.put(topic, data, congestion_control=self._drop)

    def subscribe(self, pattern: str, take: Callable[[bytes], None]) -> None:
        """Call `take`, in a thread of Zenoh, with each message whose topic matches a pattern."""
        self._subscribers.append(
            self._session.declare_subscriber(pattern, lambda sample: take(bytes(sample.payload)))
        )

    def close(self) -> None:
        """Close the session after the published messages are sent. Wait `CLOSE_S` at most.

        Zenoh's own `close` waits ten seconds while a process still retries to listen. It does not cancel the
        task of the retries (eclipse-zenoh/zenoh issue 2675 and pull request 2754, both open in August 2026).
        The connections end with the process at the latest, and the other peers notice.
        """
        if self._peers:
            self._peers.leave()
        closing = threading.Thread(target=self._close_session, daemon=True)
        closing.start()
        closing.join(CLOSE_S)

    def _close_session(self) -> None:
        with suppress(self._error):
            self._session.close()


def tls_places(places: LabRadio) -> list[str]:
    """Return additional endpoints with TLS on any free port, for the hosts of the certificate."""
    if not places.has_certificates:
        return []
    named = places.listen or (places.connect if places.is_loopback else [])
    hosts = (place.partition("/")[2].rpartition(":")[0] for place in named)
    return [f"tls/{host}:0" for host in dict.fromkeys(hosts) if host]


def is_plain(places: LabRadio) -> bool:
    """Return whether all endpoints of a lab file are on loopback and without TLS."""
    plain = len(places.plain_places) == len(places.listen) + len(places.connect)
    return not places.has_certificates and places.is_loopback and plain
