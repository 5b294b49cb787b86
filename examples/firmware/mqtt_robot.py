"""ESP32 robot that obeys an MQTT topic; save it as `main.py`. Driver: `mqtt://BROKER`."""

import json
from time import sleep_ms, ticks_diff, ticks_ms

import settings
from machine import WDT, Timer
from motors import drive
from umqtt.simple import MQTTClient
from wheels import Wheels

wheels = Wheels(settings.ROBOT, drive, ticks_ms, ticks_diff)


QUIET_CHECKS = 2
"""Checks without a message, 10 ms apart, after which the newest command counts. After a gap in the connection
the broker delivers all that waited, at once and in order; the old ones among them must not move the robot."""

newest = None


def take(topic, data):
    """Keep the newest command. Zero acts at once."""
    global newest
    try:
        found = json.loads(data)
        robot, number, v, w = [found[key] for key in ("robot", "number", "forward_mps", "turn_radps")]
        newest = int(robot), int(number), float(v), float(w)
    except (ValueError, TypeError, KeyError):
        return
    if newest[2] == newest[3] == 0:
        wheels.hear(*newest)


client = MQTTClient(f"robot{settings.ROBOT}", settings.BROKER)
client.set_callback(take)
client.connect()
client.subscribe(settings.TOPIC)
Timer(0).init(period=50, callback=lambda timer: wheels.check())  # also while the connection blocks the loop
watchdog = WDT(timeout=5000)  # resets the chip, whose motors are off then, if this loop hangs
try:
    while True:
        command, quiet = None, 0
        while quiet < QUIET_CHECKS:
            newest = None
            client.check_msg()
            watchdog.feed()
            if newest:
                command, quiet = newest, 0
            else:
                quiet += 1
                sleep_ms(10)
        if command:
            wheels.hear(*command)
finally:
    drive(0.0, 0.0)
