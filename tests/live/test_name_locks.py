"""Locks on process names: one holder per machine, also while it is suspended."""

import os
import signal
import subprocess
import sys

import pytest
from live_processes import free_port, wait_for

from skyherd.errors import InputError
from skyherd.live import name_locks
from skyherd.live.lab import load_lab
from skyherd.live.name_locks import hold_name

HOLDER = """
import sys, time
from skyherd.live.lab import load_lab
from skyherd.live.name_locks import hold_name

with hold_name(load_lab("triangle", sys.argv[1:]), "robot/3"):
    print("held", flush=True)
    time.sleep(600)
"""


def settings_of(port: int, team: str = "triangle") -> list[str]:
    place = f'["tcp/127.0.0.1:{port}"]'
    return [f"team={team}", f"radio.listen={place}", f"radio.connect={place}"]


def take(lab, name: str, wait_s: float = 0.0) -> None:
    """Hold a name, and release it at once."""
    with hold_name(lab, name, wait_s=wait_s):
        pass


@pytest.fixture
def port() -> int:
    return free_port()


def test_name_is_exclusive_until_released(port) -> None:
    lab = load_lab("triangle", settings_of(port))
    with hold_name(lab, "robot/3"):
        with (
            pytest.raises(
                InputError, match="robot/3 of team triangle: already runs on this machine"
            ) as error,
            hold_name(lab, "robot/3"),
        ):
            pass
        assert f"process {os.getpid()}" in str(error.value)
        take(lab, "robot/4")
    take(lab, "robot/3")


@pytest.mark.parametrize("other", ["team", "port"])
def test_names_of_other_team_or_radio_are_independent(port, other) -> None:
    settings = settings_of(port, "red") if other == "team" else settings_of(free_port())
    with hold_name(load_lab("triangle", settings_of(port)), "world"):
        take(load_lab("triangle", settings), "world")


def test_labs_with_a_common_endpoint_share_names(port) -> None:
    elsewhere = f'radio.listen=["tcp/127.0.0.1:{free_port()}"]'
    lab = load_lab("triangle", settings_of(port))
    with hold_name(lab, "live run"), pytest.raises(InputError, match="already runs"):
        take(load_lab("triangle", [*settings_of(port), elsewhere]), "live run")


def test_invalid_lock_folder_is_one_line(port, monkeypatch, tmp_path) -> None:
    (tmp_path / "file").write_text("")
    monkeypatch.setattr(name_locks, "lock_folder", lambda: tmp_path / "file" / "locks")
    with pytest.raises(InputError, match="a lock file that can be opened"):
        take(load_lab("triangle", settings_of(port)), "world")


def test_name_stays_held_while_suspended_and_is_freed_by_kill(port) -> None:
    settings = settings_of(port)
    lab = load_lab("triangle", settings)
    holder = subprocess.Popen([sys.executable, "-c", HOLDER, *settings], stdout=subprocess.PIPE, text=True)
    try:
        assert holder.stdout.readline() == "held\n"
        os.kill(holder.pid, signal.SIGSTOP)
        with pytest.raises(InputError, match=f"process {holder.pid}"):
            take(lab, "robot/3", wait_s=0.2)
    finally:
        holder.kill()
        holder.wait()
        holder.stdout.close()
    take(lab, "robot/3")


def test_hold_waits_for_release_of_the_name(port) -> None:
    settings = settings_of(port)
    holder = subprocess.Popen([sys.executable, "-c", HOLDER, *settings], stdout=subprocess.PIPE, text=True)
    try:
        assert holder.stdout.readline() == "held\n"
        killer = subprocess.Popen(["sh", "-c", f"sleep 0.5; kill -9 {holder.pid}"])
        with hold_name(load_lab("triangle", settings), "robot/3", wait_s=60.0):
            wait_for(lambda: holder.poll() is not None, "the end of the holder")
        killer.wait()
    finally:
        holder.kill()
        holder.wait()
        holder.stdout.close()
