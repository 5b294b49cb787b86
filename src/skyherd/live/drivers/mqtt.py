"""Motions as JSON, sent to an MQTT broker.

    topic  skyherd/robots/3/cmd_vel
    {"robot": 3, "number": 17, "forward_mps": 0.125, "turn_radps": -0.4}

with `left_mps` and `up_mps` for flying units. Messages have quality of service 0 and are not retained, since
stale commands must not be delivered. The last will is a zero command: the broker sends it if the connection
breaks without a disconnect message.
"""

import json
import socket
import threading
import time
from dataclasses import replace
from typing import Any, NamedTuple
from urllib.parse import parse_qsl, unquote, urlsplit

from skyherd.errors import InputError
from skyherd.live.drivers.link import STILL, Motion
from skyherd.plugins import import_extra

PORTS = {"mqtt": 1883, "mqtts": 8883}
"""Default ports of the broker, by scheme. *Defined* by MQTT."""

TOPIC = "skyherd/robots/{robot}/cmd_vel"
"""Default topic."""

CONNECT_S = 4.0
"""Timeout of the connection to the broker, s. *Chosen*."""

KEEP_ALIVE_S = 5
"""Keep-alive period, s; after 1.5 periods of silence the broker sends the last will. *Chosen*: the robot's
watchdog has stopped it long before."""

WRITE_S, POLL_S = 0.2, 0.005
"""Timeout of sending a message and its polling period, s. *Chosen*: the limit of `Link.write`."""

SEND_BUFFER_BYTES = 4096
"""Size of the socket's send buffer, bytes. *Chosen*: about twenty commands; while it is full, new ones are
dropped. The broker may deliver buffered commands late, so a robot needs its own watchdog."""


def payload_of(robot_id: int, number: int, motion: Motion) -> bytes:
    """Return a motion as JSON. `number` counts the messages."""
    values = {"robot": robot_id, "number": number}
    speeds = {"forward_mps": motion.forward_mps, "turn_radps": motion.turn_radps}
    if motion.flies:
        speeds |= {"left_mps": motion.left_mps, "up_mps": motion.up_mps}
    return json.dumps(values | speeds, allow_nan=False).encode()


class Broker(NamedTuple):
    """A broker and the topic of the commands.

    Attributes:
        name: address without user, password and options.
        host: host of the broker.
        port: TCP port of the broker.
        topic: topic of the commands.
    """

    name: str
    host: str
    port: int
    topic: str


def broker_of(address: str, robot_id: int) -> Broker:
    """Return the broker and the topic of `mqtt://user:password@host:1883/topic`.

    Raises:
        InputError: the host is missing, or the topic has wildcards.
        ValueError: the port is invalid.
    """
    parts = urlsplit(address)
    name = f"{parts.scheme}://{parts.netloc.rpartition('@')[2]}{parts.path}"
    topic = unquote(parts.path.strip("/")) or TOPIC.format(robot=robot_id)
    if not parts.hostname:
        raise InputError(
            f"driver {name}", "a host is missing", f"{parts.scheme}://192.168.1.23/robot3/cmd_vel"
        )
    if any(char in topic for char in "+#\0"):
        raise InputError(f"driver {name}", f"topic {topic!r}", "a topic without + and #")
    return Broker(name, parts.hostname, parts.port or PORTS[parts.scheme], topic)


class Mqtt:
    """Link that publishes motions to a broker, and reconnects after a failure.

    Args:
        address: `mqtt://host`, `mqtts://user:password@host:8883/topic?ca=broker.pem`.
        robot_id: the robot.

    Raises:
        InputError: the broker does not answer or refuses, or paho-mqtt is not installed.
    """

    def __init__(self, address: str, robot_id: int) -> None:
        broker, parts = broker_of(address, robot_id), urlsplit(address)
        self.name, self._topic = broker.name, broker.topic
        self._where = f"driver {self.name}"
        library = import_extra("paho.mqtt.client", "paho-mqtt", self._where, "live")
        self._robot, self._number = robot_id, 0
        self._client = library.Client(library.CallbackAPIVersion.VERSION2)
        if parts.username:
            self._client.username_pw_set(unquote(parts.username), unquote(parts.password or ""))
        self._answered, self._refusal = threading.Event(), ""
        self._client.on_connect = self._on_connect
        self._client.on_socket_open = _small_buffer
        self._client.connect_timeout = CONNECT_S
        self._client.reconnect_delay_set(1, 8)
        self._client.will_set(self._topic, payload_of(robot_id, 0, replace(STILL, flies=True)))
        try:
            if parts.scheme == "mqtts":
                self._client.tls_set(dict(parse_qsl(parts.query)).get("ca"))
            self._client.connect(broker.host, broker.port, KEEP_ALIVE_S)
        except (OSError, ValueError) as error:
            words = " ".join(str(getattr(error, "strerror", None) or error).split())
            raise InputError(self._where, words or "no answer", "a broker that can be reached") from None
        self._client.loop_start()
        if not self._answered.wait(CONNECT_S) or self._refusal:
            self._client.loop_stop()
            why = f"refused: {self._refusal}" if self._refusal else f"no answer within {CONNECT_S:g} s"
            raise InputError(self._where, why, "an MQTT broker, with its user and password")

    def _on_connect(self, client: Any, user: Any, flags: Any, reason: Any, properties: Any) -> None:
        self._refusal = str(reason) if reason.is_failure else ""
        self._answered.set()

    def write(self, motion: Motion) -> None:
        """Publish a motion; see `Link.write`."""
        if not self._client.is_connected():
            raise OSError("no connection to the broker")
        self._drain()
        self._client.publish(self._topic, payload_of(self._robot, self._number, motion))
        self._number += 1

    def _drain(self) -> None:
        """Wait until earlier messages are sent. Raise OSError after `WRITE_S`."""
        ends_s = time.monotonic() + WRITE_S
        while self._client.want_write():
            if time.monotonic() >= ends_s:
                raise OSError("the broker accepts no data")
            time.sleep(POLL_S)

    def close(self) -> None:
        """Send pending messages and disconnect; see `Link.close`."""
        try:
            self._drain()
            self._client.disconnect()
        except OSError:
            pass  # No disconnect message, so that the broker sends the last will.
        finally:
            self._client.loop_stop()


def _small_buffer(client: Any, user: Any, connection: Any) -> None:
    connection.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, SEND_BUFFER_BYTES)
