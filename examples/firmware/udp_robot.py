"""ESP32 robot that obeys lines in UDP packets; save it as `main.py`. Driver: `udp://ROBOT:9000`."""

import select
import socket
from time import ticks_diff, ticks_ms

import settings
from machine import WDT
from motors import drive
from wheels import Wheels, parse

wheels = Wheels(settings.ROBOT, drive, ticks_ms, ticks_diff)
receiver = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
receiver.bind(socket.getaddrinfo("0.0.0.0", settings.UDP_PORT)[0][-1])
poller = select.poll()
poller.register(receiver, select.POLLIN)
watchdog = WDT(timeout=1000)  # resets the chip, whose motors are off then, if this loop hangs
try:
    while True:
        if poller.poll(20):
            command = parse(receiver.recv(100))
            if command:
                wheels.hear(*command)
        wheels.check()
        watchdog.feed()
finally:
    drive(0.0, 0.0)
