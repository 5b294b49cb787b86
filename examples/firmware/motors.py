"""Motors of an ESP32 with a DRV8833 or a similar driver: two PWM inputs for each motor."""

from machine import PWM, Pin

HALF_TRACK_M = 0.05
"""Half of the distance between the wheels, m. Measure yours."""
FULL_MPS = 0.4
"""Speed of a wheel at full duty, m/s. Measure yours."""
LEFT, RIGHT = [[PWM(Pin(pin), freq=2000, duty_u16=0) for pin in pins] for pins in ((25, 26), (27, 14))]


def drive(v, w):
    """Turn the wheels for a speed, m/s, and a turn rate, rad/s, counter-clockwise."""
    for (forward, back), speed in ((LEFT, v - w * HALF_TRACK_M), (RIGHT, v + w * HALF_TRACK_M)):
        duty = int(min(abs(speed) / FULL_MPS, 1.0) * 65535)
        forward.duty_u16(duty if speed > 0 else 0)
        back.duty_u16(duty if speed < 0 else 0)
