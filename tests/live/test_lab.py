"""Lab files: built-in labs are valid, and each error is one line that names the key."""

import tomllib
from pathlib import Path

import numpy as np
import pytest
from command_line import call

from skyherd.control import BodyRule
from skyherd.datasets import load_mission
from skyherd.errors import InputError, InputErrors
from skyherd.live.drivers.driver import HOLD_S
from skyherd.live.lab import LabRadio, lab_names, lab_text, load_lab, make_lab
from skyherd.sim.robot_teams import make_avoidance


@pytest.fixture
def webcams(tmp_path) -> Path:
    """Return a file with a copy of the built-in lab `webcams`."""
    file = tmp_path / "lab.toml"
    file.write_text(lab_text("webcams"), encoding="utf-8")
    return file


@pytest.mark.smoke
@pytest.mark.parametrize("name", lab_names())
def test_built_in_labs_are_valid_and_stay_on_loopback(name) -> None:
    lab = load_lab(name)
    assert lab.model.radio.is_loopback and lab.model.radio.is_secured
    for unit in range(len(lab.model.cameras)):
        lab.make_unit(unit)
    core = lab.make_robot(lab.ids[0])
    assert not core.armed


def test_points_belong_to_robots_in_the_order_of_the_file() -> None:
    tree = tomllib.loads(lab_text("webcams"))
    tree["robots"] = [{"id": 9}, {"id": 2}, {"id": 5}]
    tree["shape"] = {"points": [[0, 0], [1, 0], [0, 2]]}
    lab = make_lab(tree)
    np.testing.assert_array_equal(lab.template.ids, [2, 5, 9])
    np.testing.assert_array_equal(lab.template.points_px, [1, -2j, 0])


@pytest.mark.parametrize(
    ("setting", "complaint"),
    [
        ("limits.max_speed_mps=inf", "limits.max_speed_mps"),
        ("limits.max_speed_mps=-1", "limits.max_speed_mps"),
        ("limits.max_speed_mps=500", "limits.max_speed_mps"),
        ("limits.goal_timeout_s=0.05", "two period_s"),
        ("markers.side_m=nan", "markers.side_m"),
        ("markers.dictionary='5x5'", "dictionary"),
        (
            "markers.on_robots=[{}, {add_to_id=5, offset_sides=[1, 0]}]",
            "overlaps that of markers.on_robots.0",
        ),
        ("markers.on_robots=[{}, {add_to_id=49, offset_sides=[2, 0]}]", "but 4X4_50 has 50 markers"),
        ("markers.on_robots=[{}, {add_to_id=1, offset_sides=[2, 0]}]", "would share the marker 1"),
        ("robots.0.id=999", "no marker 999"),
        ("robots.0.id=1", "1 is there twice"),
        ("shape.shape='heart'", "heart"),
        ("cameras.0.detector='eyes'", "eyes"),
        ("team='two words'", "team"),
        ("radio.speed=3", "unknown key"),
    ],
)
def test_wrong_values_are_one_line(setting, complaint) -> None:
    with pytest.raises(InputError, match=complaint) as refusal:
        load_lab("webcams", [setting])
    assert "\n" not in str(refusal.value)


@pytest.mark.parametrize(
    ("setting", "line"),
    [
        ("shape.shape=hexagon", "shape.shape: no shape 'hexagon'; one of circle, "),
        ("shape.shape=word:SKYHERD", "shape.shape: 4 robots to write SKYHERD; "),
        (
            "shape.points=[[0, 0], [1, 0]]",
            "webcams.toml: shape: both shape and points; give exactly one of shape and points",
        ),
        ("markers.dictionary=foo", "markers.dictionary: no dictionary 'foo'; one of 4X4_100, "),
        ("team='ü m'", "team: 'ü m'; 1 to 40 letters, digits, _ and -; the first is not -"),
        ("team=''", "team: ''; 1 to 40 letters"),
        (f"team={'a' * 41}", f"team: '{'a' * 41}'; 1 to 40 letters"),
        ("robots.2.id=0", "robots.2.id: 0 is there twice; each robot its own marker"),
        ("robots.1.id=50", "robots.1.id: 4X4_50 has no marker 50; 0 to 49, "),
        ("cameras.0.detector=eyes", "cameras.0.detector: no detector 'eyes'; one of "),
        (
            "limits.period_s=0.5",
            "webcams.toml: limits.goal_timeout_s: 0.6; at least two period_s, which is 1",
        ),
    ],
)
def test_wrong_setting_of_a_lab_names_option_and_what_is_allowed(webcams, setting, line) -> None:
    """A problem of two keys, of which the option gave one, names the file."""
    with pytest.raises(InputError) as refusal:
        load_lab(str(webcams), [setting])
    said = str(refusal.value).replace(str(webcams), "webcams.toml")
    assert said.startswith(line if line.startswith("webcams.toml") else f"settings: {line}")


def test_all_problems_of_a_lab_are_reported_together(webcams) -> None:
    tree = tomllib.loads(webcams.read_text())
    tree["colour"] = 1
    tree["markers"]["dictionary"] = "4X4_5"
    tree["limits"] |= {"max_speed_mps": 500, "most_turn_radps": 1}
    with pytest.raises(InputErrors) as refusal:
        make_lab(tree, where="lab.toml")
    lines = [line.removeprefix("lab.toml: ") for line in refusal.value.lines]
    assert lines[0].startswith("colour: unknown key; ")
    assert lines[1] == "limits.most_turn_radps: unknown key; renamed to max_turn_radps"
    assert {line.partition(":")[0] for line in lines[2:]} >= {"markers.dictionary", "limits.max_speed_mps"}


def test_checks_of_a_lab_report_all_problems_together(webcams) -> None:
    wrong = ["robots.0.id=999", "cameras.0.detector=trackin", "team='a b'", "robots.1.driver=foo"]
    with pytest.raises(InputErrors) as refusal:
        load_lab(str(webcams), wrong)
    said = refusal.value.lines
    assert len(said) == 4 and all(line.startswith("settings: ") for line in said)
    assert any("did you mean 'tracking'?" in line for line in said)


@pytest.mark.parametrize(
    ("address", "words"),
    [
        ("foo", "no driver 'foo'; ros2://…, mqtt://…, "),
        ("tcp://a:99999", "no driver 'tcp://a:99999'; ros2://…, "),
        ("tcp://user:secret@a:9", "no driver 'tcp://a:9'; ros2://…, "),
        ("os:", "no driver 'os:'"),
        ("mqtt://", "mqtt://: a host is missing; mqtt://"),
        ("mqtt://user:secret@a:99999", "Port out of range"),
        ("mqtt://a/+", "a topic without + and #"),
        ("udp://a:99999", "udp://a:99999: Port out of range"),
        ("udp://a", "a host or a port is missing"),
        ("udp://[::1", "Invalid IPv6 URL"),
        ("serial://", "no port"),
        ("serial://dev/ttyUSB0", "no port"),
        ("serial:///dev/nope?baud=x", "baud 'x'; a number of bits a second"),
        ("serial:///dev/nope?baud=0", "baud '0'"),
        ("serial:///dev/nope?speed=9600", "option 'speed'; baud and pty"),
        ("ros2://a:99999/cmd_vel", "Port out of range"),
        ("ros2:///cmd_vel?type=Pose", "Twist or TwistStamped"),
    ],
)
def test_invalid_driver_is_refused_by_every_reader_of_a_lab(webcams, address, words) -> None:
    for entry in ("robots.1", "cameras.1"):
        with pytest.raises(InputError) as refusal:
            load_lab(str(webcams), [f"{entry}.driver='{address}'"])
        line = str(refusal.value)
        assert line.startswith(f"settings: {entry}.driver: ") and words in line
        assert "\n" not in line and "secret" not in line


@pytest.mark.parametrize(
    "address",
    [
        "ros2://host/robot{id}/cmd_vel?type=TwistStamped",
        "mqtts://user:secret@host:8884/topic?ca=broker.pem",
        "serial:///dev/ttyUSB7?baud=57600",
        "udp://no-such-host.invalid:9000",
        "dry-run",
        "world",
        "module_on_another_machine:factory=TEXT",
    ],
)
def test_driver_of_another_machine_is_accepted_unopened(address) -> None:
    assert load_lab("webcams", [f"robots.1.driver='{address}'"]).model.robots[1].driver == address


def test_check_imports_custom_factories_without_a_call(capsys, tmp_path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    (tmp_path / "wheels_to_check.py").write_text("def make(robot_id, text): raise RuntimeError\n")
    check = ["live", "check", "webcams", "--no-cameras", "--set"]
    assert call(capsys, *check, "robots.0.driver='wheels_to_check:make'")[0] == 0, "found, and not called"
    for address, words in (
        ("os:path", "'path' is not callable"),
        ("wheels_to_check:no", "no attribute 'no'"),
    ):
        code, out, err = call(capsys, *check, f"robots.0.driver='{address}'")
        assert code == 2 and not out and f"webcams: robots.0.driver: {address}: " in err and words in err


def test_team_name_may_have_non_ascii_letters() -> None:
    assert load_lab("webcams", ["team='ü-2_b'"]).model.team == "ü-2_b"


FILES = {"authority": "a.pem", "certificate": "c.pem", "key": "k.pem"}


@pytest.mark.parametrize(
    ("radio", "secured"),
    [
        ({"listen": ["tcp/127.0.0.1:7450"], "connect": ["tcp/[::1]:7450"]}, True),
        ({"listen": ["tcp/0.0.0.0:7450"]}, False),
        ({"listen": ["tcp/192.168.0.2:7450"]}, False),
        ({"listen": ["tls/192.168.0.2:7450"]}, False),
        ({"listen": ["tls/192.168.0.2:7450"], "connect": []} | FILES, True),
        ({"listen": ["tcp/192.168.0.2:7450"]} | FILES, False),
        ({"connect": ["tcp/lab-server:7450"]}, False),
        ({"connect": ["tcp/127.0.0.1.evil.net:7450"]}, False),
    ],
)
def test_remote_radio_needs_certificates_or_consent(radio, secured) -> None:
    places = LabRadio(**radio)
    assert places.is_secured is secured
    places.check(insecure=True)
    if secured:
        places.check(insecure=False)
    else:
        with pytest.raises(InputError, match="`insecure=True`"):
            places.check(insecure=False)


def test_verbs_show_and_check(capsys, tmp_path) -> None:
    assert call(capsys, "live", "show")[1].split() == lab_names()
    file = tmp_path / "lab.toml"
    file.write_text(call(capsys, "live", "show", "webcams")[1])
    assert call(capsys, "live", "check", file, "--no-cameras")[0] == 0
    code, out, _ = call(capsys, "live", "check", file, "--set", "cameras.*.address='/dev/video77'")
    assert code == 2 and "no such camera" in out


class TestBodies:
    """Keys of a lab whose robots have bodies."""

    ON = ("avoidance.on=true", "avoidance.body_radius_sides=1")

    def test_left_out_means_no_avoidance(self) -> None:
        lab = load_lab("webcams")
        assert not lab.model.avoidance.on and lab.model.obstacles == []
        assert lab.make_controller(0).bodies is None
        assert lab.make_avoidance() is None

    def test_units_report_radii_of_robots_and_obstacles(self) -> None:
        settings = ["avoidance.margin_sides=0.5", "avoidance.horizon_sides=5"]
        lab = load_lab("webcams", [*self.ON, *settings, "obstacles=[{id=40, radius_sides=1.6}, {id=9}]"])
        bodies = lab.make_controller(0).bodies
        assert bodies == BodyRule(1.0, 0.5, 5.0, {40: 1.6, 9: 1.0})
        assert lab.body_ids == [0, 1, 2, 3, 9, 40]

    def test_rule_has_the_margins_that_the_file_states(self) -> None:
        settings = ["avoidance.stamp_error_s=0.2", "limits.clock_uncertainty_s=0.05", "control.delay_s=0.3"]
        rule = load_lab("webcams", [*self.ON, *settings, "drive.max_accel_mps2=0.3"]).make_avoidance()
        assert rule is not None
        assert rule.clock_margin_s == pytest.approx(0.25)
        assert rule.step_s == pytest.approx(HOLD_S + 0.05)
        assert rule.lag_s == pytest.approx(0.3 + 0.15 / 0.3)
        assert rule.line_s == pytest.approx(rule.held_s)
        assert rule.bearing_error_rad == pytest.approx(1.5 * (0.25 + 0.05))
        assert rule.superseded_age_s == 0.0

    def test_brakes_left_out_are_the_acceleration_limit(self) -> None:
        rule = load_lab("webcams", [*self.ON, "limits.max_accel_mps2=0.1"]).make_avoidance()
        assert rule is not None and rule.lag_s == pytest.approx(0.15 / 0.1)

    def test_simulated_and_live_rule_share_the_wheel_errors(self) -> None:
        errors = {"gain_error": 0.1, "slip": 0.02, "wheel_step_mps": 0.01, "dead_zone_mps": 0.02}
        scenario = load_mission("crowd", [f"robots.drive.{key}={value}" for key, value in errors.items()])
        lab = load_lab("crowd", [f"drive.{key}={value}" for key, value in errors.items()])
        live, simulated = lab.make_avoidance(), make_avoidance(scenario.scenario)
        assert live is not None
        assert (live.overshoot, live.creep_mps) == (simulated.overshoot, simulated.creep_mps)
        assert live.overshoot > 0 < live.turn_error_radps

    @pytest.mark.parametrize(
        ("settings", "line"),
        [
            (["avoidance.on=true"], "avoidance.body_radius_sides: 0 with avoidance.on; the radius of the "),
            ([*ON, "avoidance.lifetime_s=0.5"], "avoidance.lifetime_s: 0.5; at least limits.goal_timeout_s"),
            ([*ON, "control.axis_offset_m=0.1"], "control.axis_offset_m: 0.1 with avoidance.on; 0, the "),
            (["obstacles=[{id=2}]"], "obstacles.0.id: 2 is the marker of robot 2; a marker of its own"),
            (["obstacles=[{id=8}, {id=8}]"], "obstacles.1.id: 8 is the marker of obstacle 0; a marker of"),
            (["obstacles=[{id=77}]"], "obstacles.0.id: 77, but 4X4_50 has 50 markers; an id from 0 to 49, "),
            (["obstacles=[{id=8, radius_sides=-1}]"], "obstacles.0.radius_sides: "),
            (["obstacles=[{id=8, position_m=[0, 0]}]"], "obstacles.0.position_m: unknown key"),
            (["avoidance.body_radius_sides=-1"], "avoidance.body_radius_sides: "),
            (["avoidance.detour='left'"], "avoidance.detour: "),
            (["drive.gain_error=1"], "drive.gain_error: "),
            (["drive.delay_s=1"], "drive.delay_s: unknown key"),
        ],
    )
    def test_wrong_values_name_the_key(self, webcams, settings, line) -> None:
        with pytest.raises(InputError) as refusal:
            load_lab(str(webcams), settings)
        place = line.replace("obstacles.", "obstacles: ")
        # An error of a default value, caused by another key, names the file.
        assert str(refusal.value).startswith((f"settings: {place}", f"{webcams}: {place}"))
        assert "\n" not in str(refusal.value)


class TestTable:
    """The lab `table`, and the scenario that replaces its hardware."""

    def test_lab_and_scenario_describe_the_same_table(self) -> None:
        lab, mission = load_lab("table").model, load_mission("table")
        assert [robot.id for robot in lab.robots] == mission.ids.tolist()
        assert lab.markers.side_m == mission.scenario.marker.side_m
        assert lab.shape.size == mission.scenario.size and lab.shape.shape == "grid"
        assert len(lab.cameras) == len(mission.scenario.units) == 1
        assert any(mission.scenario.units[0].tilt_deg)

    @pytest.mark.slow
    def test_scenario_forms_its_shape_from_pixels(self, tmp_path, capsys) -> None:
        settings = ["--set", "duration_s=25", "--no-video", "--out", tmp_path / "run"]
        code, out, _ = call(capsys, "run", "table", *settings)
        assert code == 0 and "Shape reached" in out


def test_digest_leaves_out_what_differs_between_machines(tmp_path) -> None:
    """Addresses, radio and recording are a machine's own; limits, ids and gains are the team's."""
    lab = load_lab("triangle")
    own = [
        "cameras.0.address=/dev/video3",
        "robots.2.driver=dry-run",
        "radio.listen=['tcp/127.0.0.1:7999']",
        "recording.image_width_px=100",
    ]
    of_team = ["limits.max_speed_mps=0.11", "control.k=0.31", "markers.side_m=0.1234", "control.neighbors=4"]
    assert len(lab.digest) == 16
    assert all(load_lab("triangle", [one]).digest == lab.digest for one in own)
    assert len({lab.digest, *(load_lab("triangle", [one]).digest for one in of_team)}) == 5
    again = make_lab(lab.model.model_dump(mode="json"), where="recording")
    assert again.digest == lab.digest
