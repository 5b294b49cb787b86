"""Radio over Zenoh: all processes are peers, without a broker or router."""

import json
import threading
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

from skyherd.errors import InputError
from skyherd.live.lab import LabRadio
from skyherd.live.mailbox import Radio
from skyherd.plugins import import_extra

ANY_PORT = "tcp/127.0.0.1:0"
"""Additional endpoint of a process without TLS: any free port of loopback. Only one process of a machine gets
the port of the lab file. The others connect to it, learn each other's endpoints, and connect directly."""

RETRY_MS = 300
"""Interval of retries to listen and to connect, ms. Chosen: a new process may be without peers for this
time."""

CLOSE_S = 1.0
"""Timeout of `ZenohRadio.close`, s. Chosen: published messages are sent within milliseconds."""


class ZenohRadio(Radio):
    """Zenoh session in peer mode, without multicast scouting.

    Peers exchange the endpoints that they know, so each one needs to reach only one other. A process without
    the port of the lab file retries, and takes it over when it is free: no process is a single point of
    failure. It also retries to connect. Two processes that start together find no port open at first.

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
        settings: dict[str, Any] = {
            "mode": "peer",
            "listen/endpoints": [*places.listen, *additional_places(places)],
            "listen/exit_on_failure": False,
            "listen/timeout_ms": -1,
            "listen/retry": {"period_init_ms": RETRY_MS, "period_max_ms": RETRY_MS},
            "connect/endpoints": places.connect,
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
        closing = threading.Thread(target=self._close_session, daemon=True)
        closing.start()
        closing.join(CLOSE_S)

    def _close_session(self) -> None:
        with suppress(self._error):
            self._session.close()


def additional_places(places: LabRadio) -> list[str]:
    """Return the additional endpoints of a process, on any free port.

    With certificates they use TLS and the hosts of the lab file, for which the certificate was issued.
    Without certificates there is one plain endpoint on loopback, if all endpoints of the file are plain and
    on loopback.
    """
    if places.has_certificates:
        named = places.listen or (places.connect if places.is_loopback else [])
        hosts = (place.partition("/")[2].rpartition(":")[0] for place in named)
        return [f"tls/{host}:0" for host in dict.fromkeys(hosts) if host]
    plain = len(places.plain_places) == len(places.listen) + len(places.connect)
    return [ANY_PORT] if places.is_loopback and plain else []
