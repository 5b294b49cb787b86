"""Endpoints of processes on one machine: found while they run, and no others."""

import os
import signal
import subprocess
import sys

import pytest
from live_processes import free_port, wait_for

from skyherd.live import name_locks
from skyherd.live.lab import LabRadio
from skyherd.live.local_peers import MAX_PEERS, PLAIN, LocalPeers


@pytest.fixture(autouse=True)
def folder(monkeypatch, tmp_path):
    monkeypatch.setattr(name_locks, "lock_folder", lambda: tmp_path / "locks")
    return tmp_path / "locks"


def test_processes_with_the_same_places_find_each_other(folder) -> None:
    one, other, stranger = LocalPeers(["a", "b"]), LocalPeers(["b", "a"]), LocalPeers(["a"])
    assert one.others() == []
    for peers in (one, other, stranger):
        peers.enter()
    assert one.others() == [other.own] and other.others() == [one.own] and stranger.others() == []
    other.leave()
    assert one.others() == [] and PLAIN.fullmatch(one.own)


def test_files_of_ended_processes_are_removed(folder) -> None:
    peers = LocalPeers(["a"])
    peers.enter()
    ended = subprocess.Popen([sys.executable, "-c", ""])
    ended.wait()
    (own,) = folder.iterdir()
    stale = own.with_name(own.name.replace(str(os.getpid()), str(ended.pid)))
    stale.write_text("tcp/127.0.0.1:1")
    kept = folder / "another-file"
    kept.write_text("")
    assert LocalPeers(["a"]).others() == [peers.own]
    assert sorted(folder.iterdir()) == sorted([own, kept])


@pytest.mark.parametrize("text", ["tcp/10.0.0.1:80", "tls/127.0.0.1:1", "", "tcp/127.0.0.1:1\n", "x" * 10**6])
def test_other_endpoints_than_plain_loopback_are_ignored(folder, text) -> None:
    """Any user of the machine can write into the folder."""
    peers = LocalPeers(["a"])
    peers.enter()
    (own,) = folder.iterdir()
    own.write_text(text)
    assert LocalPeers(["a"]).others() == []


def test_a_large_team_is_not_connected_to_as_a_whole(folder) -> None:
    team = [LocalPeers(["a"]) for _ in range(3 * MAX_PEERS)]
    for peers in team:
        peers.enter()
    found = LocalPeers(["a"]).others()
    assert len(set(found)) == MAX_PEERS and set(found) <= {peers.own for peers in team}


OWNER = """
import sys, time
from pathlib import Path
from skyherd.live import name_locks
from skyherd.live.lab import LabRadio
from skyherd.live.zenoh_radio import ZenohRadio

name_locks.lock_folder = lambda: Path(sys.argv[2])
radio = ZenohRadio(LabRadio(listen=[sys.argv[1]], connect=[sys.argv[1]]), Path())
while True:
    radio.publish("skyherd/t/heartbeat/owner", b"owner")
    time.sleep(0.05)
"""


@pytest.mark.slow
def test_newcomer_hears_the_others_of_a_suspended_owner(folder, tmp_path) -> None:
    """The process that owns the port of the lab file accepts connections while it is suspended."""
    pytest.importorskip("zenoh")
    from skyherd.live.zenoh_radio import ZenohRadio

    place = f"tcp/127.0.0.1:{free_port()}"
    places = LabRadio(listen=[place], connect=[place])
    owner = subprocess.Popen([sys.executable, "-c", OWNER, place, str(folder)])
    radios: list[ZenohRadio] = []
    try:
        heard: set[bytes] = set()
        radios.append(ZenohRadio(places, tmp_path))
        radios[0].subscribe("skyherd/**", heard.add)
        wait_for(lambda: b"owner" in heard, "the owner of the port")
        os.kill(owner.pid, signal.SIGSTOP)
        news: set[bytes] = set()
        radios.append(ZenohRadio(places, tmp_path))
        radios[1].subscribe("skyherd/**", news.add)

        def is_heard() -> bool:
            radios[0].publish("skyherd/t/heartbeat/first", b"first")
            return b"first" in news

        wait_for(is_heard, "the first process")
    finally:
        owner.kill()
        owner.wait()
        for radio in radios:
            radio.close()
