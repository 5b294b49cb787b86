"""Firmware of `examples/firmware`, run by the unix port of MicroPython with stand-ins for its hardware."""

import os
import shutil
import subprocess
import sys
import threading
import time
from contextlib import contextmanager
from pathlib import Path

FIRMWARE = Path(__file__).parents[2] / "examples" / "firmware"
"""Folder of the firmware."""

STAND_INS = {
    "motors": """
        def drive(v, w):
            print(v, w)
    """,
    "machine": """
        import _thread
        from time import sleep_ms

        class WDT:
            def __init__(self, timeout):
                self.timeout = timeout

            def feed(self):
                pass

        class Timer:
            def __init__(self, number):
                pass

            def init(self, period, callback):
                def run():
                    while True:
                        sleep_ms(period)
                        callback(self)

                _thread.start_new_thread(run, ())
    """,
    "microbit": """
        import select
        import sys
        from time import sleep_ms as sleep

        class Uart:
            def init(self, baudrate):
                self.poller = select.poll()
                self.poller.register(sys.stdin, select.POLLIN)

            def read(self):
                data = b""
                while self.poller.poll(0) and len(data) < 64:
                    data += sys.stdin.buffer.read(1)
                return data or None

        uart = Uart()
    """,
    "utime": "from time import *",
    "umqtt/__init__": "",
    "umqtt/simple": """
        import select
        import sys

        class MQTTClient:
            # Messages are the lines of standard input; `hang` blocks the connection.
            def __init__(self, name, broker):
                self.poller = select.poll()
                self.poller.register(sys.stdin, select.POLLIN)

            def set_callback(self, take):
                self.take = take

            def connect(self):
                pass

            def subscribe(self, topic):
                self.topic = topic

            def check_msg(self):
                if self.poller.poll(0):
                    line = sys.stdin.readline().strip()
                    if line == "hang":
                        sys.stdin.readline()
                    else:
                        self.take(self.topic, line.encode())
    """,
}
"""Modules of the hardware, for the unix port: motors that print, and inputs from standard input."""


def interpreter() -> str | None:
    """Return the path of MicroPython, beside Python or on the path, or None."""
    return shutil.which("micropython", path=Path(sys.executable).parent) or shutil.which("micropython")


def install(folder: Path, main: str, **settings: object) -> None:
    """Copy a firmware and the stand-ins into a folder, as one copies it to a robot."""
    for name in ("wheels.py", main):
        shutil.copy(FIRMWARE / name, folder)
    for name, text in STAND_INS.items():
        path = folder / f"{name}.py"
        path.parent.mkdir(exist_ok=True)
        lines = text.strip("\n").splitlines()
        indent = min((len(line) - len(line.lstrip()) for line in lines if line.strip()), default=0)
        path.write_text("\n".join(line[indent:] for line in lines) + "\n")
    lines = [
        f"{name} = {value!r}" for name, value in {"ROBOT": 0, "TOPIC": "t", "BROKER": "b", **settings}.items()
    ]
    (folder / "settings.py").write_text("\n".join(lines) + "\n")


class Robot:
    """A running firmware.

    Attributes:
        process: its process.
        drives: times, s, and the speeds and turn rates that its motors got.
    """

    def __init__(self, process: subprocess.Popen) -> None:
        self.process, self.drives = process, []
        self._thread = threading.Thread(target=self._read, daemon=True)
        self._thread.start()

    def _read(self) -> None:
        for line in self.process.stdout:
            v, w = map(float, line.split())
            self.drives.append((time.monotonic(), (v, w)))

    @property
    def speeds(self) -> tuple[float, float] | None:
        """Newest speed and turn rate; None before the first."""
        return self.drives[-1][1] if self.drives else None

    def drives_at(self, speeds, within_s: float = 5.0) -> bool:
        """Wait until the motors get these speeds; return whether they did in time."""
        ends_s = time.monotonic() + within_s
        while self.speeds != speeds and time.monotonic() < ends_s:
            time.sleep(0.005)
        return self.speeds == speeds


@contextmanager
def running(folder: Path, main: str, stdin=subprocess.PIPE):
    """Run an installed firmware, and end it."""
    program = [interpreter(), "-X", "heapsize=1m", main]
    with subprocess.Popen(
        program, cwd=folder, stdin=stdin, stdout=subprocess.PIPE, stderr=subprocess.PIPE, env=os.environ
    ) as process:
        try:
            yield Robot(process)
        finally:
            process.kill()
