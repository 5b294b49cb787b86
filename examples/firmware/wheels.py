"""Commands and watchdog of a robot with two wheels, for MicroPython.

The wheels turn in the state DRIVING alone.

| state | a new command | leads to |
|---|---|---|
| BOOT | zero | DRIVING |
| DRIVING | with a newer number | DRIVING |
| DRIVING | none for HOLD_MS | PAUSED |
| PAUSED | with a newer number, or zero with any | DRIVING |

All others are ignored: repeated and late ones, those for other robots, and too fast ones. Zero always stops.
"""

BOOT, DRIVING, PAUSED = range(3)
HOLD_MS = 300
"""Longest time without a new command, ms."""
MAX_MPS, MAX_RADPS = 0.3, 3.0
"""Largest accepted speed and turn rate."""


class Wheels:
    """State machine of the wheels. `drive(v, w)` sets speed and turn rate; the ticks are those of `time`."""

    def __init__(self, robot, drive, ticks_ms, ticks_diff):
        self.robot, self.drive, self.ticks_ms, self.ticks_diff = robot, drive, ticks_ms, ticks_diff
        self.state, self.last, self.heard_ms = BOOT, 0, 0
        drive(0.0, 0.0)

    def hear(self, robot, number, v, w):
        """Obey a command, m/s and rad/s, if the state permits it."""
        if robot != self.robot or not (abs(v) <= MAX_MPS and abs(w) <= MAX_RADPS):
            return
        zero, newer = v == 0 and w == 0, 0 < (number - self.last) % 65536 < 32768
        if zero:
            self.drive(0.0, 0.0)
        if (self.state != BOOT and newer) or (self.state != DRIVING and zero):
            self.state, self.last, self.heard_ms = DRIVING, number, self.ticks_ms()
            self.drive(v, w)

    def check(self):
        """Stop the wheels when the last command is too old. Called every 50 ms or more often."""
        if self.state == DRIVING and self.ticks_diff(self.ticks_ms(), self.heard_ms) > HOLD_MS:
            self.state = PAUSED
            self.drive(0.0, 0.0)


def speed_of(text):
    """Return the number of a text such as `-0.4000`; two lost zeros do not change a line's exclusive or."""
    whole, decimals = text.split(".")
    if len(whole.lstrip("-")) != 1 or len(decimals) != 4:
        raise ValueError
    return float(text)


def parse(line):
    """Return robot, number, speed and turn rate of a line such as `V,3,17,0.1250,-0.4000*4C`, or None."""
    try:
        text, check = line.strip().split(b"*")
        left = int(check, 16)
        for byte in text:
            left ^= byte
        kind, robot, number, v, w = text.decode().split(",")
        return (int(robot), int(number), speed_of(v), speed_of(w)) if kind == "V" and left == 0 else None
    except (ValueError, UnicodeError):
        return None
