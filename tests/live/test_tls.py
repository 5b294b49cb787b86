"""The radio over TLS with client certificates: who has none of the team's is neither heard nor told."""

import datetime
import ipaddress
import time

import pytest
from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID
from live_processes import free_port, wait_for

from skyherd.live.lab import LabRadio

PEM = serialization.Encoding.PEM
PLAIN = (serialization.PrivateFormat.PKCS8, serialization.NoEncryption())


def name(text):
    return x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, text)])


def make_authority(folder, who):
    """An authority's key and certificate; the latter is written too."""
    key = ec.generate_private_key(ec.SECP256R1())
    certificate = (
        _certificate(who, who, key)
        .add_extension(x509.BasicConstraints(ca=True, path_length=0), critical=True)
        .sign(key, hashes.SHA256())
    )
    (folder / f"{who}.pem").write_bytes(certificate.public_bytes(PEM))
    return who, key


def make_member(folder, who, authority):
    """Write a certificate for 127.0.0.1 that an authority signed, and its key."""
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
def test_members_hear_each_other_and_a_stranger_is_neither_heard_nor_hears(folder) -> None:
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
        join("stranger")  # whose certificate another authority signed
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
