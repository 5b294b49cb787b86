"""Scenario files: valid ones are read, and each error has one line."""

import tomllib

import cv2
import numpy as np
import pytest

from skyherd.datasets import Scenario, load_mission, make_mission, scenario_names, scenario_text, shape_points
from skyherd.errors import InputError
from skyherd.markers.dictionary import marker_cells

GOOD = """
name = "mine"
duration_s = 10.0
[template]
points = [[0, 0], [1, 0], [0, 1]]
[robots]
positions_m = [[0, 0], [2, 0], [0, 2]]
headings_deg = [0, 0, 0]
[marker]
side_m = 0.4
[[units]]
position_m = [1, 1]
height_m = 10
camera = { half_angle_deg = 30 }
"""

# Replaced text, its replacement, and the words required in the one line: key, value or allowed values.
BAD = {
    "malformed": ("duration_s = 10.0", "duration_s = = 10", ["malformed TOML"]),
    "unknown_key": ("side_m = 0.4", "side_m = 0.4\nsize = 3", ["marker.size", "unknown key"]),
    "wrong_type": ("height_m = 10", 'height_m = "high"', ["units.0.height_m", "'high'"]),
    "noise_that_nobody_measured": (
        "duration_s = 10.0",
        'duration_s = 10.0\ndetector = "opencv-subpix"\nperception = "noisy"',
        ["nobody measured the noise of 'opencv-subpix'", "photometric, tracking, opencv"],
    ),
    "negative_length": (
        "side_m = 0.4",
        "side_m = -0.4",
        ["marker.side_m: -0.4; a finite number from 0.001 to 1000"],
    ),
    "nan_length": ("side_m = 0.4", "side_m = nan", ["marker.side_m", "finite"]),
    "nan_position": ("[2, 0]", "[nan, 0]", ["robots.positions_m.1.0", "finite"]),
    "missing_key": ("side_m = 0.4", "", ["marker.side_m", "missing"]),
    "one_robot": (
        "positions_m = [[0, 0], [2, 0], [0, 2]]\nheadings_deg = [0, 0, 0]",
        "positions_m = [[0, 0]]",
        ["at least two"],
    ),
    "duplicate_ids": ("headings_deg = [0, 0, 0]", "ids = [4, 5, 4]", ["ids", "4", "once"]),
    "id_not_in_dictionary": ("headings_deg = [0, 0, 0]", "ids = [0, 1, 77]", ["77", "50 markers", "0 to 49"]),
    "one_spot": ("[2, 0]", "[0, 0]", ["robots 0 and 1", "one spot"]),
    "missing_template_id": ("[[0, 0], [1, 0], [0, 1]]", "[[0, 0], [1, 0]]", ["template", "robot(s) [2]"]),
    "coincident_template": ("[[0, 0], [1, 0], [0, 1]]", "[[1, 1], [1, 1], [1, 1]]", ["template", "coincide"]),
    "two_shapes": ("[template]", '[template]\nshape = "star"', ["template", "exactly one"]),
    "unknown_dictionary": ("side_m = 0.4", 'side_m = 0.4\ndictionary = "9X9"', ["9X9", "4X4_50"]),
    "unknown_detector": (
        "duration_s = 10.0",
        'duration_s = 10.0\ndetector = "best"',
        ["best", "photometric"],
    ),
    "detector_that_is_gone": (
        "duration_s = 10.0",
        'duration_s = 10.0\ndetector = "aruco"',
        ["no detector 'aruco'; photometric, or opencv"],
    ),
    "two_focal_lengths": ("half_angle_deg = 30", "half_angle_deg = 30, focal_px = 900", ["exactly one"]),
    "name_is_a_path": ('name = "mine"', 'name = "../mine"', ["name: '../mine'; 1 to 100 letters"]),
    "huge_id": (
        "headings_deg = [0, 0, 0]",
        "ids = [0, 1, 99999999999999999999]",
        ["robots.ids.2", "below 2147483648"],
    ),
    "far_away": ("[2, 0]", "[1e200, 0]", ["robots.positions_m.1.0", "1000000"]),
    "blur_wider_than_the_image": ("[[units]]", "[sensor]\npsf_px = 1e4\n[[units]]", ["sensor.psf_px", "10"]),
    "no_robots": ("positions_m = [[0, 0], [2, 0], [0, 2]]", "positions_m = []", ["robots"]),
    "two_desired_points": (
        "[[0, 0], [1, 0], [0, 1]]",
        "[[0, 0], [1, 0], [1, 0]]",
        ["robots 1 and 2", "one point"],
    ),
    "below_the_autopilot": ("height_m = 10", "height_m = 1", ["units.0.height_m: 1 is outside", "3 to 100"]),
    "frames_faster_than_steps": (
        "height_m = 10",
        "height_m = 10\nframe_rate_hz = 60",
        ["units.0.frame_rate_hz: 60 is more", "step_s of 0.1; at most 10"],
    ),
    "count_and_positions": ("headings_deg = [0, 0, 0]", "count = 99", ["99", "3 positions"]),
    "folding_lens": (
        "half_angle_deg = 30",
        "half_angle_deg = 30, distortion = { k1 = -2.0 }",
        ["units.0.camera.distortion: the lens folds the image over; smaller k1"],
    ),
    "lens_folds_when_zoomed_out": (
        "camera = { half_angle_deg = 30 }",
        "camera = { half_angle_deg = 30, distortion = { k1 = -0.3 } }\nzoom = [[0, 1], [5, 0.4]]",
        ["units.0.camera.distortion"],
    ),
    "ground_of_sand": (
        "[[units]]",
        '[ground]\nkind = "sand"\n[[units]]',
        ["ground.kind: 'sand'; one of plain, concrete"],
    ),
    "image_without_its_kind": (
        "[[units]]",
        '[ground]\nimage = "a.png"\n[[units]]',
        ["ground.image: given with the kind concrete; leave it out"],
    ),
    "missing_ground_image": (
        "[[units]]",
        '[ground]\nkind = "image"\nimage = "absent.png"\n[[units]]',
        ["absent.png"],
    ),
    "jpeg_quality_of_0": ("[[units]]", "[sensor]\njpeg_quality = 0\n[[units]]", ["sensor.jpeg_quality", "1"]),
    "more_shadow_than_light": ("[[units]]", "[sensor]\nshadow = 1.5\n[[units]]", ["sensor.shadow", "1.5"]),
    "half_a_disc": ("[[units]]", "[[occluders]]\ncenter_m = [0, 0]\n[[units]]", ["occluders.0", "radius_m"]),
    "crossed_quad": (
        "[[units]]",
        "[[occluders]]\ncorners_m = [[0, 0], [1, 1], [1, 0], [0, 1]]\n[[units]]",
        ["occluders.0", "convex"],
    ),
    "unordered_zoom": ("height_m = 10", "height_m = 10\nzoom = [[5, 1], [0, 2]]", ["zoom", "ascend"]),
}


@pytest.mark.smoke
@pytest.mark.parametrize("name", scenario_names())
def test_built_in_scenarios_are_valid_and_start_far_from_goal(name):
    mission = load_mission(name)
    assert mission.template.ids.tolist() == mission.ids.tolist() == list(range(mission.ids.size))


@pytest.mark.smoke
@pytest.mark.parametrize("case", BAD)
def test_what_is_wrong_is_said_in_one_line(tmp_path, case):
    old, new, said = BAD[case]
    assert old in GOOD
    file = tmp_path / "mine.toml"
    file.write_text(GOOD.replace(old, new, 1))
    with pytest.raises(InputError) as caught:
        load_mission(str(file))
    message = str(caught.value)
    assert "\n" not in message
    assert message.startswith(str(file))
    for words in said:
        assert words in message, message


def test_missing_and_binary_files_are_named(tmp_path):
    with pytest.raises(InputError, match=r"absent\.toml.*no such file"):
        load_mission(str(tmp_path / "absent.toml"))
    with pytest.raises(
        InputError,
        match=f"one of {', '.join(scenario_names())}",
    ):
        load_mission("no-such-name")
    binary = tmp_path / "binary.toml"
    binary.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(InputError, match="not a text file"):
        load_mission(str(binary))


def test_more_robots_than_the_dictionary_has():
    tree = tomllib.loads(scenario_text("grid"))
    tree["robots"]["count"] = 60
    with pytest.raises(InputError, match=r"60 robots.*50 markers"):
        make_mission(tree)


def test_settings_reach_into_lists_and_are_typed():
    mission = load_mission("star", ["units.1.height_m=21", "control.k=0.2", "perception=ideal"])
    assert mission.scenario.units[1].height_m == 21
    assert mission.scenario.control.k == 0.2
    assert mission.scenario.perception == "ideal"


@pytest.mark.parametrize(
    ("setting", "said"),
    [
        ("units.².height_m=3", "0 to 2"),
        ("control.k=1e308", "1000000"),
        ("control.k", "KEY=VALUE"),
        ("units.7.height_m=3", "0 to 2"),
        ("control.kk=3", "unknown key"),
    ],
)
def test_wrong_settings_are_one_line(setting, said):
    with pytest.raises(InputError, match=said):
        load_mission("star", [setting])


def test_mapping_of_settings_equals_their_texts():
    texts = ["perception=ideal", "units.*.height_m=9", "units.0.position_m=[1, 2]", "video={speed=2.0}"]
    mapping = {
        "perception": "ideal",
        "units.*.height_m": np.int64(9),
        "units.0.position_m": np.array([1, 2]),
        "video": {"speed": 2.0},
    }
    wanted = load_mission("star", texts).scenario
    assert load_mission("star", mapping).scenario == wanted
    mapping["units.0.position_m"] = (1, 2)
    assert load_mission("star", mapping).scenario == wanted
    assert load_mission("star", mapping | {"seed": 8}).scenario != wanted


@pytest.mark.parametrize(
    ("mapping", "said"),
    [
        ({"control.k": -1}, "settings: control.k: -1; a finite number from"),
        ({"contrl.k": 1}, "settings: contrl.k: unknown key; did you mean 'control'?"),
        ({3: 1}, "settings: 3: key: 3; a dotted key"),
        ({"control.k": object}, "settings: control.k: <class 'object'>; a finite number"),
        ({"perception": "ideall"}, "settings: perception: 'ideall'; did you mean 'ideal'?"),
    ],
)
def test_problem_of_a_mapping_names_its_key(mapping, said):
    with pytest.raises(InputError) as wrong:
        load_mission("star", mapping)
    assert str(wrong.value).startswith(said) and "\n" not in str(wrong.value)


def test_mission_has_a_short_representation():
    assert repr(load_mission("star", {"duration_s": 2})) == "Mission(star: 16 robots, 3 unit(s), 2 s)"


def test_scatter_is_seeded_and_keeps_its_spacing():
    first, again, other = (load_mission("grid", seed=seed) for seed in (3, 3, 4))
    np.testing.assert_array_equal(first.positions_m, again.positions_m)
    assert np.abs(first.positions_m - other.positions_m).max() > 1.0
    offsets = first.positions_m[:, None] - first.positions_m[None]
    distances = np.linalg.norm(offsets, axis=2)[np.triu_indices(40, 1)]
    assert distances.min() >= first.scenario.robots.scatter.spacing_m


def test_template_image_gives_the_shape_that_its_markers_form(tmp_path):
    # Markers centred at given points, in image sense (v down).
    places = {0: (100, 100), 1: (400, 120), 2: (180, 330)}
    image = np.full((450, 520), 255, np.uint8)
    for robot, (u, v) in places.items():
        cells = np.kron(marker_cells("4X4_50", robot).astype(np.uint8) * 255, np.ones((10, 10), np.uint8))
        image[v - 30 : v + 30, u - 30 : u + 30] = cells
    cv2.imwrite(str(tmp_path / "shape.png"), image)
    file = tmp_path / "mine.toml"
    file.write_text(GOOD.replace("points = [[0, 0], [1, 0], [0, 1]]", 'image = "shape.png"'))
    template = load_mission(str(file)).template
    # The block drawn from u - 30 to u + 29 is centred half a pixel before (u, v).
    expected = np.array([complex(u - 0.5, v - 0.5) for u, v in places.values()])
    np.testing.assert_allclose(template.points_px, expected, atol=0.3)
    cv2.imwrite(str(tmp_path / "shape.png"), image[:, ::-1])
    with pytest.raises(InputError, match=r"shape\.png.*mirrored"):
        load_mission(str(file))


def test_template_image_without_a_robot_names_it(tmp_path):
    image = np.full((200, 300), 255, np.uint8)
    for robot, u in ((0, 80), (1, 220)):
        image[70:130, u - 30 : u + 30] = np.kron(
            marker_cells("4X4_50", robot).astype(np.uint8) * 255, np.ones((10, 10), np.uint8)
        )
    cv2.imwrite(str(tmp_path / "shape.png"), image)
    file = tmp_path / "mine.toml"
    file.write_text(GOOD.replace("points = [[0, 0], [1, 0], [0, 1]]", 'image = "shape.png"'))
    with pytest.raises(InputError, match=r"no point for robot\(s\) \[2\]"):
        load_mission(str(file))


@pytest.mark.parametrize("name", ["circle", "grid", "line", "star", "triangle"])
def test_named_shapes_have_distinct_points_about_their_centroid(name):
    points = shape_points(name, 12)
    assert points.shape == (12, 2)
    assert len({tuple(point) for point in points.round(9).tolist()}) == 12
    np.testing.assert_allclose(points.mean(axis=0), 0, atol=1e-12)


def test_schema_names_every_key_of_the_built_in_scenarios():
    properties = Scenario.model_json_schema()["properties"]
    for name in scenario_names():
        assert set(tomllib.loads(scenario_text(name))) <= set(properties)


def test_an_unreadable_ground_image_is_one_line(tmp_path):
    (tmp_path / "ground.png").write_bytes(b"no picture")
    file = tmp_path / "mine.toml"
    file.write_text(GOOD.replace("[[units]]", '[ground]\nkind = "image"\nimage = "ground.png"\n[[units]]'))
    with pytest.raises(InputError, match=r"ground\.png"):
        load_mission(str(file))


@pytest.mark.parametrize("setting", [None, 3, b"seed=1"], ids=repr)
def test_a_setting_that_is_no_text_is_refused(setting):
    with pytest.raises(InputError, match=r"settings: .*; a text"):
        load_mission("star", [setting])
