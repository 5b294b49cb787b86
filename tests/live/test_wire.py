"""Wire format: exact round trips of messages, refusal of all other bytes, and mailboxes."""

import copy
import json

import hypothesis.strategies as st
import numpy as np
import pytest
from hypothesis import given, settings
from sightings import make_sighting

from skyherd.live.mailbox import MAX_ROUND_S, MAX_WAITING_BYTES, Air, Mailbox, matches
from skyherd.live.wire import (
    MAX_BYTES,
    TOO_LARGE,
    Arm,
    Envelope,
    Heartbeat,
    Refused,
    Stop,
    Wheels,
    decode,
    encode,
)
from skyherd.messages import (
    NO_SLOT,
    FlightCommand,
    MotionGoals,
    Proximity,
    RoleMap,
    TreeStatus,
    UnitReport,
)

pytestmark = pytest.mark.smoke

TEAM = "blue"


def everything() -> list[Envelope]:
    tree = TreeStatus(0, 1, 2, 3, True, [1], [4], [[5, 6]], [7], [1], [7], [8], [9], [2], [NO_SLOT], [3])
    report = UnitReport(
        0, 5.0, [640, 480], [1, 2], [[1.5, 2.5], [3, 4]], [1], [1], tree, 0.5, 20.0, RoleMap(1, 0, [1, 0])
    )
    from_unit = [
        MotionGoals(0, 5.25, [3], [1.5], [0.1], [20.0], [[1, 2]], [[3.5, 4.5]]),
        Proximity(0, 5.0, 8.0, [1, 2], [1], [2], [1.0], [0.5], [1.2], [0.5]),
        report,
        make_sighting(5.0, [1, 2], [3]),
        Heartbeat({"robot/3": (1.25, 1.5)}, "12 markers"),
        FlightCommand(0, [0.1, 0.2], 0.3, 0.4, 0.5),
    ]
    return [Envelope("unit/0", 6.125, message) for message in from_unit] + [
        Envelope("robot/3", 6.5, Wheels(3, 0.25, -0.5)),
        Envelope("robot/3", 6.5, Heartbeat({}, "disarmed", "6.5/0", True, False, "ab12", 17)),
        Envelope("operator", 7.0, Arm({"robot/3": "6.5/0"})),
        Envelope("operator", 7.0, Stop("space bar")),
    ]


def changed(**parts) -> bytes:
    return json.dumps(json.loads(encode(everything()[0], TEAM)) | parts).encode()


def body(number: int = 0, /, **parts) -> bytes:
    record = json.loads(encode(everything()[number], TEAM))
    record["body"] |= parts
    return json.dumps(record).encode()


def scalars(record, path=()):
    """Yield the paths to all numbers, booleans and strings of a plain object outside lists."""
    for name, value in record.items():
        if isinstance(value, dict):
            yield from scalars(value, (*path, name))
        elif not isinstance(value, list):
            yield (*path, name)


plain = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=5), inner, max_size=3),
    max_leaves=8,
)


class TestMailbox:
    def test_refusals_are_counted_reported_once_and_bounded(self) -> None:
        air, lines = Air(), []
        mailbox = Mailbox(air.radio("robot/3"), TEAM, "robot/3", lambda: 9.0, ["goals/**"], lines.append)
        sender = air.radio("unit/0")
        for _ in range(5):
            sender.publish("skyherd/red/goals/unit/0", changed(team="red"))
        for number in range(500):
            sender.publish("skyherd/x/goals/unit/0", changed(team=f"t{number}"))
        sender.publish("skyherd/blue/goals/unit/0", encode(everything()[0], TEAM))
        air.advance(1.0)
        arrived = list(mailbox.fetch())
        assert [arrival.received_s for arrival in arrived] == [9.0]
        assert mailbox.refusals.counts["of another team, 'red'"] == 5
        assert sum(mailbox.refusals.counts.values()) == 505 and len(mailbox.refusals.counts) < 50
        assert len(lines) == len(mailbox.refusals.counts) == len(set(lines))

    def test_own_messages_skipped_and_full_queue_drops_newest(self) -> None:
        air = Air()
        mailbox = Mailbox(air.radio("unit/0"), TEAM, "unit/0", lambda: 0.0, ["**"])
        mailbox.send(Stop("me"))
        other = Mailbox(air.radio("unit/1"), TEAM, "unit/1", lambda: 0.0, [])
        for _ in range(6000):
            other.send(Stop("other"))
        air.advance(1.0)
        assert len(list(mailbox.fetch())) == 4999
        assert mailbox.dropped == 1001

    def test_flood_does_not_hold_the_caller(self) -> None:
        """Another message arrives with each that is processed."""
        air = Air()
        mailbox = Mailbox(air.radio("unit/0"), TEAM, "unit/0", lambda: 0.0, ["**"])
        other = Mailbox(air.radio("unit/1"), TEAM, "unit/1", lambda: 0.0, [])
        for waiting in (3, 6):
            for _ in range(3):
                other.send(Stop("other"))
            air.advance(1.0)
            fetched = 0
            for _ in mailbox.fetch(1.0):
                fetched += 1
                assert fetched <= waiting
                other.send(Stop("other"))
                air.advance(1.0)
            assert fetched == waiting

    def test_round_ends_after_a_time_and_keeps_the_rest(self) -> None:
        air, now_s = Air(), [100.0]
        mailbox = Mailbox(air.radio("unit/0"), TEAM, "unit/0", lambda: now_s[0], ["**"])
        other = Mailbox(air.radio("unit/1"), TEAM, "unit/1", lambda: 0.0, [])
        for number in range(30):
            other.send(Stop(str(number)))
        air.advance(1.0)
        whys, rounds = [], 0
        while len(whys) < 30 and rounds < 30:
            begun_s, rounds = now_s[0], rounds + 1
            for arrival in mailbox.fetch(1.0):
                whys.append(arrival.envelope.message.why)
                now_s[0] += 0.004
            assert now_s[0] - begun_s <= MAX_ROUND_S + 0.004 + 1e-9
        assert rounds in (5, 6) and whys == [str(number) for number in range(30)]

    def test_large_messages_leave_room_for_a_stop(self) -> None:
        """A flood of messages just below the largest size fills the queue. One above it is refused once."""
        air, lines = Air(), []
        mailbox = Mailbox(air.radio("unit/0"), TEAM, "unit/0", lambda: 0.0, ["**"], lines.append)
        other = Mailbox(air.radio("unit/1"), TEAM, "unit/1", lambda: 0.0, [])
        for _ in range(3):
            other.send(Stop("x" * MAX_BYTES))
        for _ in range(100):
            other.send(Stop("x" * (MAX_BYTES - 300)))
        other.send(Stop("space bar"))
        air.advance(1.0)
        whys = [arrival.envelope.message.why for arrival in mailbox.fetch()]
        assert len(whys) == 1 + MAX_WAITING_BYTES // MAX_BYTES and whys[-1] == "space bar"
        assert mailbox.dropped == 101 - len(whys)
        assert mailbox.refusals.counts == {TOO_LARGE: 3}
        assert lines == ["refused a message larger than the largest message"]
        for _ in range(MAX_WAITING_BYTES // MAX_BYTES):
            other.send(Stop("x" * (MAX_BYTES - 300)))
        air.advance(2.0)
        assert len(list(mailbox.fetch())) == MAX_WAITING_BYTES // MAX_BYTES, "read messages leave room"


def test_air_drops_delays_and_orders_by_arrival() -> None:
    air = Air(drop=lambda topic, receiver: receiver == "deaf")
    heard: dict[str, list[bytes]] = {"deaf": [], "near": []}
    for name, into in heard.items():
        air.radio(name).subscribe("skyherd/*/a/**", into.append)
    late = iter([0.3, 0.1, 0.2])
    air.delay_s = lambda topic, receiver: next(late)
    sender = air.radio("sender")
    for data in (b"1", b"2", b"3"):
        sender.publish("skyherd/t/a/x", data)
    air.advance(0.15)
    assert heard == {"deaf": [], "near": [b"2"]}
    air.advance(1.0)
    assert heard["near"] == [b"2", b"3", b"1"]


@pytest.mark.parametrize(
    ("pattern", "topic", "fits"),
    [
        ("skyherd/*/goals/**", "skyherd/t/goals/unit/0", True),
        ("skyherd/*/goals/**", "skyherd/t/goals", True),
        ("skyherd/*/heartbeat/unit/*", "skyherd/t/heartbeat/robot/3", False),
        ("skyherd/*/goals/**", "skyherd/t/u/goals/unit/0", False),
        ("a/*", "a", False),
    ],
)
def test_patterns_match_topics(pattern, topic, fits) -> None:
    assert matches(pattern, topic) is fits


class TestDecode:
    @pytest.mark.parametrize("envelope", everything(), ids=lambda envelope: envelope.kind)
    def test_messages_round_trip_exactly(self, envelope) -> None:
        data = encode(envelope, TEAM)
        arrived = decode(data, TEAM)
        assert (arrived.sender, arrived.sent_s) == (envelope.sender, envelope.sent_s)
        assert type(arrived.message) is type(envelope.message)
        assert encode(arrived, TEAM) == data

    @pytest.mark.parametrize(
        ("data", "why"),
        [
            (b"\xff\x00", "not JSON"),
            (b"[" * 100_000, "not JSON"),
            (b"[1]", "not a message of skyherd"),
            (b"x" * (MAX_BYTES + 1), "larger"),
            (changed(team="red"), "another team, 'red'"),
            (changed(version=2), "of format '2', not 5"),
            (changed(version=True), "of format"),
            (changed(sender=5), "without a valid sender"),
            (changed(sender=""), "without a valid sender"),
            (changed(sent_s=None), "time of sending"),
            (changed(sent_s=1e300), "time of sending"),
            (changed(sent_s=True), "time of sending"),
            (changed(kind="order"), "unknown kind"),
            (changed(kind=[]), "unknown kind"),
            (changed(instance=None), "without an instance"),
            (changed(instance="x" * 41), "without an instance"),
            (changed(stop=-1), "goals of a wrong shape"),
            (changed(stop=True), "goals of a wrong shape"),
            (changed(stop=1.0), "goals of a wrong shape"),
            (changed(cleared=2**53 - 1), "goals of a wrong shape"),
            (changed(cleared=None), "goals of a wrong shape"),
            (changed(body=None), "goals of a wrong shape"),
            (changed(body={}), "goals of a wrong shape"),
            (changed(sender="unit/1"), "for another process"),
            (changed(sender="operator"), "for another process"),
            (body(ids="3"), "wrong shape"),
            (body(ids=[3.5]), "wrong shape"),
            (body(ids=[10**30]), "wrong shape"),
            (body(rho_px=[-1.0]), "wrong shape"),
            (body(rho_px=[None]), "wrong shape"),
            (body(rho_px=[[1.0]]), "wrong shape"),
            (body(unit_id="0"), "wrong shape"),
            (body(unit_id=True), "wrong shape"),
            (body(rho_px=[1e200]), "goals with rho_px outside 0 to 1e.06 from 'unit/0'"),
            (body(sides_px=[1e-200]), "goals with sides_px outside 0.1 to 1e.06"),
            (body(bearings_rad=[1e308]), "bearings_rad outside -10 to 10"),
            (body(neighbor_distances_px=[[1e150, 1.0]]), "neighbor_distances_px outside"),
            (body(2, points_px=[[1e12, 0.0], [0.0, 0.0]]), "report with points_px outside"),
            (body(2, side_px=1e300), "report with side_px outside"),
            (body(2, roles={"version": 2**60, "author_id": 0, "roles": [1, 0]}), "version outside"),
            (body(1, distances_sides=[1e300]), "distances_sides outside"),
            (body(1, shares=[2.0]), "shares outside 0 to 1"),
            (body(5, climb_mps=1e9), "climb_mps outside"),
            (body(3, centers_px=[[1e200, 0.0], [0.0, 0.0]]), "sighting with centers_px outside"),
            (body(3, headings_rad=[1e300, 0.0]), "headings_rad outside"),
            (body(3, sides_px=[1e-200, 1.0]), "sides_px outside"),
            (body(3, sides_px=[0.0, 1.0]), "wrong shape"),
            (body(3, headings_rad=[0.0]), "wrong shape"),
            (body(time_s=1e200), "wrong shape"),
            (body(time_s="now"), "wrong shape"),
        ],
    )
    def test_invalid_bytes_are_refused_with_a_reason(self, data, why) -> None:
        with pytest.raises(Refused, match=why):
            decode(data, TEAM)

    @pytest.mark.parametrize("envelope", everything(), ids=lambda envelope: envelope.kind)
    @pytest.mark.parametrize("other", [None, [], [1], {}, [[1.0]]], ids=repr)
    def test_wrong_type_of_any_scalar_is_refused(self, envelope, other) -> None:
        whole = json.loads(encode(envelope, TEAM))
        for path in scalars(whole["body"]):
            record = copy.deepcopy(whole)
            part = record["body"]
            for name in path[:-1]:
                part = part[name]
            part[path[-1]] = other
            with pytest.raises(Refused, match="wrong shape"):
                decode(json.dumps(record).encode(), TEAM)

    @given(
        number=st.integers(0, len(everything()) - 1),
        where=st.integers(0, 30),
        inside=st.booleans(),
        value=plain,
    )
    @settings(max_examples=60)
    def test_any_changed_value_is_decoded_or_refused(self, number, where, inside, value) -> None:
        record = json.loads(encode(everything()[number], TEAM))
        part = record["body"] if inside and record["body"] else record
        part[sorted(part)[where % len(part)]] = value
        try:
            data = json.dumps(record).encode("utf-8", "surrogatepass")
            decoded = decode(data, TEAM)
        except Refused:
            return
        assert decoded.sender == record["sender"]

    def test_numbers_round_trip_exactly(self) -> None:
        """The shortest decimal form of a double reads back exactly, since replays compare bits."""
        rng = np.random.default_rng(1)
        times_s = 1.7e9 + rng.uniform(0, 1e6, 50)
        for time_s in times_s.tolist():
            sent = Envelope("unit/0", time_s, make_sighting(time_s, [1]))
            arrived = decode(encode(sent, TEAM), TEAM)
            assert arrived.sent_s == time_s and arrived.message.time_s == time_s
