"""micro:bit robot that obeys lines on its USB port; save it as `main.py`. Driver: `serial:///dev/ttyACM0`."""

from microbit import sleep, uart
from motors import drive
from utime import ticks_diff, ticks_ms
from wheels import Wheels, parse

ROBOT = 0

wheels, line = Wheels(ROBOT, drive, ticks_ms, ticks_diff), b""
uart.init(baudrate=115200)
try:
    while True:
        line += uart.read() or b""
        while b"\n" in line:
            first, line = line.split(b"\n", 1)
            command = parse(first)
            if command:
                wheels.hear(*command)
        line = line[-100:]
        wheels.check()
        sleep(20)
finally:
    drive(0.0, 0.0)
