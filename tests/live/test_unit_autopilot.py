"""Flight commands of a unit, written by a driver as those of a flying unit."""

import socket
from contextlib import ExitStack
from types import SimpleNamespace

import numpy as np

from skyherd.live.drivers import SpeedLimits
from skyherd.live.unit_process import _autopilot
from skyherd.messages import FlightCommand


def test_autopilot_receives_flight_commands_and_stop() -> None:
    """Straight flight and the zeros at the end also have lines with four speeds."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as autopilot:
        autopilot.bind(("127.0.0.1", 0))
        autopilot.settimeout(20)
        camera = SimpleNamespace(driver=f"udp://127.0.0.1:{autopilot.getsockname()[1]}")
        lab = SimpleNamespace(camera=lambda unit: camera, speed_limits=SpeedLimits(acceleration_mps2=1e6))
        with ExitStack() as stack:
            pilot = _autopilot(SimpleNamespace(lab=lab, dry_run=False), None, stack, 2)
            assert pilot.trouble() is None
            pilot.fly(FlightCommand(2, np.array([0.0, -0.1]), climb_mps=0.0, yaw_rate_radps=0.0))
            lines = [autopilot.recv(100)]
            while b",0.1000," not in lines[-1]:
                lines.append(autopilot.recv(100))
        lines += [autopilot.recv(100) for _ in range(2)]
    assert all(line.startswith(b"F,2,") for line in lines)
