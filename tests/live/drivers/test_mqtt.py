"""Motions over MQTT: payloads, and delivery by a real broker if one is installed."""

import json
import queue
import shutil
import signal
import socket
import subprocess
import time

import pytest

from skyherd.errors import InputError
from skyherd.live.drivers import STILL, Motion, open_driver
from skyherd.live.drivers.mqtt import Mqtt, payload_of

BROKER = shutil.which("mosquitto") or shutil.which("mosquitto", path="/usr/sbin:/usr/local/sbin")


def test_payload_has_the_documented_format() -> None:
    assert payload_of(3, 17, Motion(0.125, -0.4)) == (
        b'{"robot": 3, "number": 17, "forward_mps": 0.125, "turn_radps": -0.4}'
    )
    assert json.loads(payload_of(3, 0, Motion(1, 2, 3, 4, flies=True)))["up_mps"] == 4
    assert json.loads(payload_of(3, 0, Motion(0, 0, flies=True)))["left_mps"] == 0
    with pytest.raises(ValueError, match="JSON compliant"):
        payload_of(3, 0, Motion(float("nan"), 0.0))


@pytest.fixture
def broker(tmp_path):
    """Yield the port of a broker on loopback, and its process."""
    pytest.importorskip("paho.mqtt.client")
    if BROKER is None:
        pytest.skip("no mosquitto on this machine: apt-get install mosquitto")
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    (tmp_path / "users").write_text("")
    configuration = tmp_path / "mosquitto.conf"
    configuration.write_text(f"listener {port} 127.0.0.1\nallow_anonymous true\npersistence false\n")
    with subprocess.Popen(
        [BROKER, "-c", str(configuration)], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    ) as process:
        try:
            for _ in range(1000):
                with socket.socket() as probe:
                    if probe.connect_ex(("127.0.0.1", port)) == 0:
                        break
                time.sleep(0.01)
            yield port, process
        finally:
            process.send_signal(signal.SIGCONT)
            process.terminate()


def listener(port):
    """Yield a client of all topics, and its queue of (topic, payload)."""
    import paho.mqtt.client as paho

    heard: queue.Queue = queue.Queue()
    ready = queue.Queue()
    client = paho.Client(paho.CallbackAPIVersion.VERSION2)
    client.on_subscribe = lambda *_: ready.put(True)
    client.on_message = lambda _c, _u, message: heard.put(
        (message.topic, json.loads(message.payload), message.retain)
    )
    client.connect("127.0.0.1", port)
    client.loop_start()
    client.subscribe("#")
    ready.get(timeout=20)
    return client, heard


class TestBroker:
    def test_broker_delivers_motions_and_final_zero(self, broker) -> None:
        port, _ = broker
        client, heard = listener(port)
        with open_driver(f"mqtt://127.0.0.1:{port}", robot_id=3) as driver:
            driver.send_motion(Motion(0.001, 0.01))
            while (message := heard.get(timeout=20))[1]["forward_mps"] != 0.001:
                pass
            topic, payload, retained = message
            assert topic == "skyherd/robots/3/cmd_vel" and payload["robot"] == 3 and not retained
            assert payload["turn_radps"] == 0.01 and payload["number"] > 0
        numbers, last = [], None
        while last is None or last["forward_mps"] or len(numbers) < 3:
            last = heard.get(timeout=20)[1]
            numbers.append(last["number"])
        assert numbers == list(range(numbers[0], numbers[0] + len(numbers)))
        client.disconnect()
        client.loop_stop()

    def test_last_will_stops_the_robot(self, broker) -> None:
        port, _ = broker
        client, heard = listener(port)
        link = Mqtt(f"mqtt://127.0.0.1:{port}/robots/seven", 7)
        link.write(Motion(0.5, 0.5))
        assert heard.get(timeout=20)[1]["forward_mps"] == 0.5
        link._client._sock_close()  # The connection ends without a disconnect message, as after SIGKILL.
        topic, payload, _ = heard.get(timeout=20)
        assert topic == "robots/seven" and payload["forward_mps"] == payload["turn_radps"] == 0
        assert payload["left_mps"] == payload["up_mps"] == 0, "the will of a unit that flies, too"
        link._client.loop_stop()
        client.disconnect()
        client.loop_stop()

    @pytest.mark.slow
    def test_hanging_broker_gets_few_stale_commands(self, broker) -> None:
        port, process = broker
        link = Mqtt(f"mqtt://127.0.0.1:{port}", 0)
        process.send_signal(signal.SIGSTOP)
        taken = 0
        with pytest.raises(OSError, match=r"accepts no data|no connection"):
            for taken in range(200_000):  # noqa: B007
                link.write(STILL)
        assert taken < 100_000
        process.send_signal(signal.SIGCONT)
        link.close()

    def test_absent_broker_is_refused(self, broker) -> None:
        _, process = broker
        process.terminate()
        process.wait(20)
        with pytest.raises(InputError, match="refused"):
            Mqtt(f"mqtt://127.0.0.1:{broker[0]}", 0)
