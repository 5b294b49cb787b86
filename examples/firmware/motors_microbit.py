"""Motors of a micro:bit with a two-channel driver at P13 to P16; copy it as `motors.py`."""

from microbit import pin13, pin14, pin15, pin16

HALF_TRACK_M = 0.05
"""Half of the distance between the wheels, m. Measure yours."""
FULL_MPS = 0.4
"""Speed of a wheel at full duty, m/s. Measure yours."""


def drive(v, w):
    """Turn the wheels for a speed, m/s, and a turn rate, rad/s, counter-clockwise."""
    sides = (((pin13, pin14), v - w * HALF_TRACK_M), ((pin15, pin16), v + w * HALF_TRACK_M))
    for (forward, back), speed in sides:
        duty = int(min(abs(speed) / FULL_MPS, 1.0) * 1023)
        forward.write_analog(duty if speed > 0 else 0)
        back.write_analog(duty if speed < 0 else 0)
