"""Radio over TLS with client certificates: it excludes processes without a certificate of the team."""

import datetime
import ipaddress
import json
import subprocess
import sys
import time
from pathlib import Path

import pytest
from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID
from live_processes import free_port, wait_for

from skyherd.errors import InputError
from skyherd.live.lab import LabRadio

PEM = serialization.Encoding.PEM
PLAIN = (serialization.PrivateFormat.PKCS8, serialization.NoEncryption())


def name(text):
    return x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, text)])


def make_authority(folder, who):
    """Write the certificate of a new authority, and return its name and its key."""
    key = ec.generate_private_key(ec.SECP256R1())
    certificate = (
        _certificate(who, who, key)
        .add_extension(x509.BasicConstraints(ca=True, path_length=0), critical=True)
        .sign(key, hashes.SHA256())
    )
    (folder / f"{who}.pem").write_bytes(certificate.public_bytes(PEM))
    return who, key


def make_member(folder, who, authority):
    """Write a certificate for 127.0.0.1, signed by an authority, and its key."""
    signer, signing_key = authority
    key = ec.generate_private_key(ec.SECP256R1())
    here = x509.SubjectAlternativeName([x509.IPAddress(ipaddress.ip_address("127.0.0.1"))])
    usage = x509.ExtendedKeyUsage([ExtendedKeyUsageOID.SERVER_AUTH, ExtendedKeyUsageOID.CLIENT_AUTH])
    certificate = (
        _certificate(who, signer, key)
        .add_extension(here, critical=False)
        .add_extension(usage, critical=False)
        .sign(signing_key, hashes.SHA256())
    )
    (folder / f"{who}.pem").write_bytes(certificate.public_bytes(PEM))
    (folder / f"{who}.key").write_bytes(key.private_bytes(PEM, *PLAIN))


def _certificate(who, signer, key):
    now = datetime.datetime.now(datetime.UTC)
    return (
        x509.CertificateBuilder()
        .subject_name(name(who))
        .issuer_name(name(signer))
        .public_key(key.public_key())
        .serial_number(x509.random_serial_number())
        .not_valid_before(now - datetime.timedelta(minutes=5))
        .not_valid_after(now + datetime.timedelta(hours=1))
    )


@pytest.fixture
def folder(tmp_path):
    team, strangers = make_authority(tmp_path, "team"), make_authority(tmp_path, "strangers")
    for who, authority in (("a", team), ("b", team), ("stranger", strangers)):
        make_member(tmp_path, who, authority)
    return tmp_path


@pytest.mark.slow
def test_tls_members_communicate_and_strangers_do_not(folder) -> None:
    pytest.importorskip("zenoh")
    from skyherd.live.zenoh_radio import ZenohRadio

    place = f"tls/127.0.0.1:{free_port()}"
    heard: dict[str, list[bytes]] = {"a": [], "b": [], "stranger": [], "naked": []}
    radios = {}

    def join(who, *, listen=(), certified=True):
        files = {"authority": "team.pem", "certificate": f"{who}.pem", "key": f"{who}.key"}
        places = LabRadio(listen=list(listen), connect=[place], **(files if certified else {}))
        radios[who] = ZenohRadio(places, folder)
        radios[who].subscribe("skyherd/t/heartbeat/**", heard[who].append)

    def all_speak():
        for who, radio in radios.items():
            radio.publish(f"skyherd/t/heartbeat/{who}", who.encode())

    try:
        join("a", listen=[place])
        join("b")
        join("stranger")  # Another authority signed its certificate.
        join("naked", certified=False)
        wait_for(lambda: (all_speak(), {b"b"} <= set(heard["a"]) and {b"a"} <= set(heard["b"]))[1], "members")
        for _ in range(40):
            all_speak()
            time.sleep(0.05)
    finally:
        for radio in radios.values():
            radio.close()
    # A process hears itself as well.
    assert set(heard["a"]) == set(heard["b"]) == {b"a", b"b"}
    assert set(heard["stranger"]) <= {b"stranger"} and set(heard["naked"]) <= {b"naked"}


FILES = {"authority": "team.pem", "certificate": "a.pem", "key": "a.key"}

LISTENER = """
import json, sys
from pathlib import Path
from skyherd.live.lab import LabRadio
from skyherd.live.zenoh_radio import ZenohRadio

radio = ZenohRadio(LabRadio(**json.loads(sys.argv[1])), Path(sys.argv[2]))
radio.subscribe("skyherd/t/**", lambda data: print(data.decode(), flush=True))
print("listening", flush=True)
sys.stdin.read()
radio.close()
"""
"""Process that prints received messages until its input ends."""

SPEAKER = """
import json, select, sys, time
from pathlib import Path
from skyherd.live.lab import LabRadio
from skyherd.live.zenoh_radio import ZenohRadio

radio = ZenohRadio(LabRadio(**json.loads(sys.argv[1])), Path(sys.argv[2]))
heard = set()
radio.subscribe("skyherd/t/**", lambda data: heard.add(data.decode()))
end_s = time.monotonic() + 60
while len(heard) < 3 and time.monotonic() < end_s:
    radio.publish("skyherd/t/heartbeat/" + sys.argv[3], sys.argv[3].encode())
    time.sleep(0.1)
print(*sorted(heard), flush=True)
while not select.select([sys.stdin], [], [], 0.1)[0]:  # until its input ends
    radio.publish("skyherd/t/heartbeat/" + sys.argv[3], sys.argv[3].encode())
radio.close()
"""
"""Process that sends messages, and prints all senders after it has heard three."""

LISTEN_STATE = "0A"
"""State of a listening socket in /proc/net/tcp. Defined by Linux."""


def listening_ports(pid: int) -> set[int]:
    """Return the TCP ports on which a process listens."""
    links = []
    for descriptor in Path(f"/proc/{pid}/fd").iterdir():
        try:
            links.append(str(descriptor.readlink()))
        except FileNotFoundError:
            continue
    ports = set()
    for table in ("tcp", "tcp6"):
        for line in Path(f"/proc/{pid}/net/{table}").read_text().splitlines()[1:]:
            fields = line.split()
            if fields[3] == LISTEN_STATE and f"socket:[{fields[9]}]" in links:
                ports.add(int(fields[1].rpartition(":")[2], 16))
    return ports


def deliver_without_certificate(ports: set[int], authority: Path) -> None:
    """Try for 3 s to send to all ports, in plain text and by TLS without a client certificate."""
    import zenoh

    sessions = []
    for protocol in ("tcp", "tls"):
        for port in ports:
            config = zenoh.Config()
            for key, value in {
                "mode": "client",
                "connect/endpoints": [f"{protocol}/127.0.0.1:{port}"],
                "connect/exit_on_failure": False,
                "connect/timeout_ms": 1000,
                "scouting/multicast/enabled": False,
                "transport/link/tls/root_ca_certificate": str(authority),
            }.items():
                config.insert_json5(key, json.dumps(value))
            try:
                sessions.append(zenoh.open(config))
            except zenoh.ZError:
                continue
    for _ in range(30):
        for session in sessions:
            session.put("skyherd/t/stop/x", b"foreign")
        time.sleep(0.1)
    for session in sessions:
        session.close()


@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc/net/tcp").exists(), reason="sockets are listed by Linux")
@pytest.mark.parametrize(
    ("listens", "certified", "delivered"),
    [
        ("tls/127.0.0.1:{port}", True, False),
        (None, True, False),
        ("tcp/127.0.0.1:{port}", False, True),  # negative control: the client can deliver
    ],
    ids=["tls", "tls, connecting only", "plain"],
)
def test_client_without_certificate_delivers_on_no_port(folder, listens, certified, delivered) -> None:
    pytest.importorskip("zenoh")
    port = free_port()
    place = (listens or "tls/127.0.0.1:{port}").format(port=port)
    places = {"listen": [place] if listens else [], "connect": [place], **(FILES if certified else {})}
    process = subprocess.Popen(
        [sys.executable, "-c", LISTENER, json.dumps(places), str(folder)],
        stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
    )  # fmt: skip
    try:
        assert process.stdout.readline() == "listening\n"
        expected = 2 if listens else 1
        wait_for(lambda: len(listening_ports(process.pid)) >= expected, "the ports")
        deliver_without_certificate(listening_ports(process.pid), folder / "team.pem")
        heard, _ = process.communicate(timeout=60)
    finally:
        process.kill()
        process.wait()
    assert ("foreign" in heard) == delivered


@pytest.mark.slow
def test_three_tls_processes_share_one_port_and_hear_each_other(folder) -> None:
    pytest.importorskip("zenoh")
    place = f"tls/127.0.0.1:{free_port()}"
    places = json.dumps({"listen": [place], "connect": [place], **FILES})
    processes = [
        subprocess.Popen(
            [sys.executable, "-c", SPEAKER, places, str(folder), name],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
        )
        for name in "abc"
    ]  # fmt: skip
    try:
        for process in processes:
            assert process.stdout.readline() == "a b c\n"
        for process in processes:
            process.communicate(timeout=60)
    finally:
        for process in processes:
            process.kill()
            process.wait()


@pytest.mark.parametrize(
    ("places", "words"),
    [
        ({"listen": ["tcp/127.0.0.1:7450"], "connect": []}, "tcp/127.0.0.1:7450 is not protected"),
        (
            {"listen": [], "connect": ["tls/127.0.0.1:7450", "udp/127.0.0.1:7450"]},
            "udp/127.0.0.1:7450 is not",
        ),
    ],
)
def test_plain_place_beside_certificates_is_refused(tmp_path, places, words) -> None:
    from skyherd.live.zenoh_radio import ZenohRadio

    with pytest.raises(InputError, match=words):
        ZenohRadio(LabRadio(**places, **FILES), tmp_path)


@pytest.mark.parametrize("missing", FILES)
def test_incomplete_certificates_are_refused(tmp_path, missing) -> None:
    from skyherd.live.zenoh_radio import ZenohRadio

    files = {key: value for key, value in FILES.items() if key != missing}
    with pytest.raises(InputError, match="all of authority, certificate and key"):
        ZenohRadio(LabRadio(listen=["tls/127.0.0.1:1"], connect=[], **files), tmp_path)


@pytest.mark.parametrize(
    ("listen", "connect", "certified", "expected"),
    [
        (["tcp/127.0.0.1:1"], ["tcp/127.0.0.1:1"], False, "plain"),
        (["tls/127.0.0.1:1"], ["tls/127.0.0.1:1"], False, []),
        (["tcp/192.168.0.2:1"], ["tcp/127.0.0.1:1"], False, []),
        (["tls/127.0.0.1:1"], ["tls/127.0.0.1:1"], True, ["tls/127.0.0.1:0"]),
        (["tls/192.168.0.2:1", "quic/[::1]:2"], [], True, ["tls/192.168.0.2:0", "tls/[::1]:0"]),
        ([], ["tls/127.0.0.1:1"], True, ["tls/127.0.0.1:0"]),
        ([], ["tls/192.168.0.3:1"], True, []),
    ],
)
def test_additional_ports_are_plain_on_unsecured_loopback_only(listen, connect, certified, expected) -> None:
    from skyherd.live.zenoh_radio import is_plain, tls_places

    places = LabRadio(listen=listen, connect=connect, **(FILES if certified else {}))
    assert is_plain(places) == (expected == "plain")
    assert tls_places(places) == ([] if expected == "plain" else expected)
