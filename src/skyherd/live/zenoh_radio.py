"""The radio by Zenoh: each process a peer, and nothing between them."""

import json
import threading
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

from skyherd.errors import InputError
from skyherd.live.drivers.extras import import_extra
from skyherd.live.lab import LabRadio
from skyherd.live.mailbox import Radio

ANY_PORT = "tcp/127.0.0.1:0"
"""Additional address on which a process without TLS listens: any port of loopback. Only one process of a
machine gets the port of the file. The others connect to it, learn of each other there, and connect here."""

RETRY_MS = 300
"""Time between two tries to get the port of the file, and to reach its owner, ms. Chosen: a new process
is alone for this time."""

CLOSE_S = 1.0
"""Longest time that leaving takes, s. Chosen: what was published is sent within milliseconds."""


class ZenohRadio(Radio):
    """A Zenoh session in peer mode, which nothing finds that is not told where.

    Multicast scouting is off. Peers tell each other of the peers that they know, so that it is enough for
    each to reach one. Where the port of the file is taken, a process tries on, and takes it over once it is
    free: no process is the middle. It tries on to reach the others, too: of two that begin at the same moment
    neither has the port yet when the other one looks for it.

    Args:
        places: where to listen and to connect to.
        folder: the folder to which names of certificates are relative.
        insecure: allow places beyond loopback without TLS and client certificates.

    Raises:
        InputError: Zenoh is not installed, the places are not secured, or Zenoh refuses them.
    """

    def __init__(self, places: LabRadio, folder: Path, *, insecure: bool = False) -> None:
        places.check(insecure=insecure)
        zenoh = import_extra("zenoh", "eclipse-zenoh", "radio")
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
        """Send to all that listen now; dropped where the line is full."""
        self._session.put(topic, data, congestion_control=self._drop)

    def subscribe(self, pattern: str, take: Callable[[bytes], None]) -> None:
        """Call `take`, from a thread of Zenoh's, with all that comes under a pattern."""
        self._subscribers.append(
            self._session.declare_subscriber(pattern, lambda sample: take(bytes(sample.payload)))
        )

    def close(self) -> None:
        """Leave the others; what was published before is sent.

        Zenoh's own closing waits ten seconds for a process that still tries to get the port of the file: the
        task that tries is not told to end (eclipse-zenoh/zenoh issue 2675 and pull request 2754, both open
        in August 2026). So this waits for `CLOSE_S` only. The connections end with the process at the latest,
        at which the others notice.
        """
        closing = threading.Thread(target=self._close_session, daemon=True)
        closing.start()
        closing.join(CLOSE_S)

    def _close_session(self) -> None:
        with suppress(self._error):
            self._session.close()


def additional_places(places: LabRadio) -> list[str]:
    """Return the addresses with a free port on which a process listens beside those of the file.

    With certificates these use TLS and the hosts of the file, for which the certificate was issued. Without
    certificates there is a plain port, on loopback only, and none if the file asks for TLS.
    """
    if places.has_certificates:
        named = places.listen or (places.connect if places.is_loopback else [])
        hosts = (place.partition("/")[2].rpartition(":")[0] for place in named)
        return [f"tls/{host}:0" for host in dict.fromkeys(hosts) if host]
    plain = len(places.plain_places) == len(places.listen) + len(places.connect)
    return [ANY_PORT] if places.is_loopback and plain else []
