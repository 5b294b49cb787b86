"""ESP32 robot that obeys an MQTT topic; save it as `main.py`. Driver: `mqtt://BROKER`."""

import json
from time import sleep_ms, ticks_diff, ticks_ms

import settings
from machine import WDT, Timer
from motors import drive
from umqtt.simple import MQTTClient
from wheels import Wheels

wheels = Wheels(settings.ROBOT, drive, ticks_ms, ticks_diff)


def take(topic, data):
    """Obey a message."""
    try:
        found = json.loads(data)
        wheels.hear(*[found[key] for key in ("robot", "number", "forward_mps", "turn_radps")])
    except (ValueError, TypeError, KeyError):
        pass


client = MQTTClient(f"robot{settings.ROBOT}", settings.BROKER)
client.set_callback(take)
client.connect()
client.subscribe(settings.TOPIC)
Timer(0).init(period=50, callback=lambda timer: wheels.check())  # also while the connection blocks the loop
watchdog = WDT(timeout=5000)  # resets the chip, whose motors are off then, if this loop hangs
try:
    while True:
        client.check_msg()
        watchdog.feed()
        sleep_ms(10)
finally:
    drive(0.0, 0.0)
