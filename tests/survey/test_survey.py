"""`skyherd survey` on rendered pictures with exact truth: frame, moving robots, layouts, and wrong input."""

import csv
import json
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from bags import raw, write_bag
from PIL import Image
from scipy.spatial.transform import Rotation

from skyherd.cli import main
from skyherd.datasets import load_mission
from skyherd.files.video_writer import VideoSink
from skyherd.markers.layout import MarkerLayout, Place
from skyherd.poses.marker_poses import pose_difference
from skyherd.render import Camera, CameraPose, Ground, Renderer, Sensor, Shot, facing_rows
from skyherd.render.camera.camera import rotation_camera_world
from skyherd.survey import Survey, take_views
from skyherd.survey import survey as measure

SIDE_M = 0.1
CAMERA = Camera((800, 600), focal_px=900.0)
POSITIONS_M = np.array([[0.0, 0.0], [0.35, 0.1], [-0.3, 0.15], [0.1, -0.3], [-0.25, -0.25], [0.3, 0.35]])
HEADINGS_RAD = np.array([0.0, 0.5, 2.0, -1.0, 3.0, 1.0])
POSES = [
    CameraPose((-0.9, 0.0), 1.7, 0.0, (0.0, np.radians(-30.0))),
    CameraPose((0.0, -0.9), 1.7, 0.3, (np.radians(-25.0), 0.0)),
    CameraPose((0.1, 0.0), 1.8, -1.0, (np.radians(-5.0), 0.0)),
]
BOX = (
    Place(0, (0.0, 0.0), 0.0, 1.5),
    Place(10, (0.75, 0.0), 0.0, 0.75, "front"),
    Place(20, (0.0, 0.75), 0.0, 0.75, "left"),
    Place(30, (-0.75, 0.0), 0.5 * np.pi, 0.75, "back"),
)
"""A box of 1.5 sides; its back marker is turned by 90 degrees."""


def take(path: Path, pose: CameraPose, ids, positions_m, headings_rad, *, seed: int, frames=None) -> Path:
    """Render a picture with noise and write it."""
    renderer = Renderer("4X4_50", SIDE_M, Ground(1), Sensor(2.0, np.random.default_rng(seed)))
    image = renderer.render(Shot(CAMERA, pose, ids, positions_m, headings_rad, frames=frames))
    Image.fromarray(image).save(path)
    return path


@pytest.fixture
def calibration(tmp_path: Path) -> Path:
    """Return a file with the intrinsics of the rendered cameras."""
    path = tmp_path / "camera.yaml"
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    storage.write("image_width", 800)
    storage.write("image_height", 600)
    storage.write("camera_matrix", CAMERA.intrinsic_matrix())
    storage.write("distortion_coefficients", np.zeros((5, 1)))
    storage.release()
    return path


@pytest.fixture
def survey(tmp_path: Path, calibration: Path, capsys: pytest.CaptureFixture[str]):
    """Return the exit code, output and frame of a survey, and its folder."""

    def run(*arguments: str | Path, camera: bool = True):
        folder = tmp_path / "out"
        usual = ["--marker-side-m", str(SIDE_M), "--out", str(folder)]
        usual += ["--camera", str(calibration)] if camera else []
        with pytest.raises(SystemExit) as end:
            main(["survey", *map(str, arguments), *usual])
        frame = folder / "frame.json"
        return end.value.code, capsys.readouterr(), json.loads(frame.read_text()) if frame.exists() else None

    return run


def true_marker(row: int, positions_m=POSITIONS_M, headings_rad=HEADINGS_RAD):
    return Rotation.from_euler("z", headings_rad[row]).as_matrix(), np.array([*positions_m[row], 0.0])


def true_camera(pose: CameraPose):
    return rotation_camera_world(pose).T, np.array([*pose.position_m, pose.height_m])


def sigmas(found: dict, rotation: np.ndarray, position_m: np.ndarray) -> np.ndarray:
    """Return the errors of a pose over its standard deviations; 0 where it has no error by definition."""
    error = pose_difference(np.array(found["rotation"]), np.array(found["position_m"]), rotation, position_m)
    std = np.sqrt(np.diag(found["covariance"]))
    assert np.abs(error[std == 0]).max(initial=0) < 1e-9
    return error[std > 0] / std[std > 0]


def test_survey_of_three_cameras_is_within_its_uncertainty(survey, tmp_path) -> None:
    """The largest of 33 numbers exceeds 4 sigma with a chance of 0.2 %; files agree with each other."""
    pictures = [
        take(tmp_path / f"view{k}.png", pose, np.arange(6), POSITIONS_M, HEADINGS_RAD, seed=k)
        for k, pose in enumerate(POSES)
    ]
    code, said, frame = survey(*pictures, "--reference", "0", "--one-plane")
    assert code == 0 and "view2" in said.out and not said.err
    assert frame["consistent"] and frame["reference"] == 0
    offs = [sigmas(one, *true_marker(one["id"])) for one in frame["markers"]]
    offs += [sigmas(one, *true_camera(pose)) for one, pose in zip(frame["cameras"], POSES, strict=True)]
    assert [one["id"] for one in frame["markers"]] == list(range(6))
    assert np.abs(np.concatenate(offs)).max() < 4
    assert np.concatenate(offs).size == 5 * 3 + 3 * 6
    rows = list(csv.DictReader((tmp_path / "out" / "cameras.csv").read_text().splitlines()))
    assert [row["picture"] for row in rows] == ["view0", "view1", "view2"]
    assert float(rows[1]["y_m"]) == pytest.approx(frame["cameras"][1]["position_m"][1], rel=1e-5)
    with Image.open(tmp_path / "out" / "plan.png") as plan:
        assert plan.size[0] == plan.size[1] > 300


def test_moving_robots_and_camera_are_located_by_fixed_markers(survey, tmp_path) -> None:
    """Markers 3 to 5 are robots that move between two pictures of one camera, which moves as well."""
    moved_m, turned_rad = POSITIONS_M.copy(), HEADINGS_RAD.copy()
    moved_m[3:] += [0.05, 0.08]
    turned_rad[3:] += 0.7
    truth = {"a": (POSITIONS_M, HEADINGS_RAD), "b": (moved_m, turned_rad)}
    pictures = [
        take(tmp_path / f"{name}.png", pose, np.arange(6), *truth[name], seed=20 + k)
        for k, (name, pose) in enumerate(zip(truth, (POSES[0], POSES[2]), strict=True))
    ]
    code, _, frame = survey(*pictures, "--fixed", "0-2", "--reference", "0")
    assert code == 0 and frame["consistent"]
    moving = [one for one in frame["markers"] if one["picture"]]
    assert [(one["picture"], one["id"]) for one in moving] == [(n, k) for n in "ab" for k in (3, 4, 5)]
    offs = [sigmas(one, *true_marker(one["id"], *truth[one["picture"]])) for one in moving]
    assert np.abs(np.concatenate(offs)).max() < 4
    # Negative control: without --fixed the pictures contradict each other.
    code, said, frame = survey(*pictures, "--reference", "0", "--force")
    assert code == 1 and not frame["consistent"]
    assert "contradict each other" in said.err and "--fixed" in said.err


def test_covariances_follow_residuals_that_exceed_the_noise(calibration, tmp_path) -> None:
    """Stated variances that are too small by any factor lead to the same covariances; chance leaves them."""
    pictures = [
        take(tmp_path / f"view{k}.png", pose, np.arange(6), POSITIONS_M, HEADINGS_RAD, seed=k)
        for k, pose in enumerate(POSES)
    ]
    views = take_views(pictures, [str(calibration)], dictionary="4X4_50")
    by_chance = measure(views, SIDE_M, reference=0, fixed=[0, 1, 2])
    assert by_chance.variance_factor == 1

    def with_noise(divisor: float) -> Survey:
        small = [replace(view, covariances=view.covariances / divisor) for view in views]
        return measure(small, SIDE_M, reference=0, fixed=[0, 1, 2])

    three, six = with_noise(3.0), with_noise(6.0)
    assert three.is_consistent and not six.is_consistent
    assert six.variance_factor / three.variance_factor == pytest.approx(2, rel=1e-6)
    assert three.variance_factor == pytest.approx(
        3 * by_chance.frame.chi_squared / by_chance.frame.freedoms, rel=1e-3
    )
    rows = zip([*three.markers, *three.cameras], [*six.markers, *six.cameras], strict=True)
    for one, other in rows:
        scale = np.abs(one.covariance).max()
        assert np.abs(one.covariance - other.covariance).max() <= 1e-4 * scale


def box_pictures(tmp_path: Path) -> list[Path]:
    """Return six pictures of one robot with four markers on a box, which stands elsewhere in each."""
    layout = MarkerLayout.make([3], BOX)
    rng, pictures = np.random.default_rng(5), []
    frames = layout.frames
    for k in range(6):
        turn, at = rng.uniform(-np.pi, np.pi), rng.uniform(-0.1, 0.1, 2)
        azimuth = 2 * np.pi * k / 6
        pose = CameraPose(
            (-0.8 * np.cos(azimuth), -0.8 * np.sin(azimuth)),
            0.9,
            0.0,
            (np.radians(-38.0) * np.sin(azimuth), np.radians(-38.0) * np.cos(azimuth)),
        )
        positions_m, headings_rad = np.tile(at, (4, 1)), np.full(4, turn)
        rows = facing_rows(pose, positions_m, headings_rad, SIDE_M, frames)
        pictures.append(
            take(
                tmp_path / f"box{k}.png",
                pose,
                layout.ids[rows],
                positions_m[rows],
                headings_rad[rows],
                seed=40 + k,
                frames=frames[rows],
            )
        )
    return pictures


def test_layout_of_a_box_is_learned(survey, tmp_path) -> None:
    """The printed TOML is read by a scenario, and has the layout up to its stated errors."""
    code, said, frame = survey(*box_pictures(tmp_path), "--fixed", "3,13,23,33", "--layout")
    assert code == 0 and frame["consistent"] and frame["reference"] == 3
    text = said.out[said.out.index("markers = [") : said.out.index("\n]") + 2]
    models = load_mission_markers(tmp_path, text)
    assert [(one.add_to_id, one.face) for one in models] == [(p.add_to_id, p.face) for p in BOX]
    by_id = {one["id"]: one for one in frame["markers"]}
    for model, place in zip(models, BOX, strict=True):
        std = np.sqrt(np.diag(by_id[3 + place.add_to_id]["covariance"]))
        true_m = SIDE_M * np.array([*place.offset_sides, place.height_sides - 1.5])
        off_m = np.array(by_id[3 + place.add_to_id]["position_m"]) - true_m
        assert np.abs(off_m / np.maximum(std[:3], 1e-9)).max() < 4.5
        assert model.yaw_deg == pytest.approx(
            np.degrees(place.yaw_rad), abs=4.5 * np.degrees(std[3:].max()) + 0.01
        )
        assert np.hypot(*np.subtract(model.offset_sides, place.offset_sides)) < 0.01


def load_mission_markers(tmp_path: Path, text: str):
    """Return the markers on robots of a scenario with `text` in its table of robots."""
    scenario = tmp_path / "robots.toml"
    scenario.write_text(
        f"""name = "boxes"
duration_s = 1.0
template = {{ shape = "triangle" }}
marker = {{ side_m = 0.1 }}
[robots]
ids = [3, 4, 5]
positions_m = [[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]]
{text}
[[units]]
position_m = [0.0, 0.0]
height_m = 5.0
camera = {{ half_angle_deg = 35.0 }}
"""
    )
    return load_mission(str(scenario)).scenario.robots.markers


def test_flat_layout_has_no_heights(survey, tmp_path) -> None:
    """Three markers on one board, in pictures of a camera that moves."""
    pictures = [
        take(tmp_path / f"flat{k}.png", pose, np.arange(3), POSITIONS_M[:3], HEADINGS_RAD[:3], seed=60 + k)
        for k, pose in enumerate(POSES)
    ]
    code, said, _ = survey(*pictures, "--fixed", "0-2", "--layout", "--reference", "0")
    assert code == 0 and "height_sides" not in said.out and "face" not in said.out
    assert "offset_sides = [3.50" in said.out and "yaw_deg = 28.6" in said.out


def test_markers_that_do_not_move_together_are_no_layout(survey, tmp_path) -> None:
    """Negative control: one marker of the supposed robot stands elsewhere in the second picture."""
    moved_m = POSITIONS_M[:3].copy()
    moved_m[2] += 0.01
    pictures = [
        take(tmp_path / f"loose{k}.png", POSES[k], np.arange(3), at_m, HEADINGS_RAD[:3], seed=70 + k)
        for k, at_m in enumerate((POSITIONS_M[:3], moved_m))
    ]
    code, said, _ = survey(*pictures, "--fixed", "0-2", "--layout", "--reference", "0")
    assert code == 1 and "contradict" in said.err


class TestWrongInput:
    """Each is one line, and leaves no folder."""

    def test_pictures_without_a_common_marker(self, survey, tmp_path) -> None:
        pictures = [
            take(tmp_path / f"{k}.png", POSES[k], ids, POSITIONS_M[ids], HEADINGS_RAD[ids], seed=80 + k)
            for k, ids in enumerate((np.array([0, 1]), np.array([2, 3])))
        ]
        self.check(survey(*pictures), "shares no marker with the other views", tmp_path)
        self.check(survey(*pictures, "--fixed", "0,1"), "1: shows no marker of --fixed", tmp_path)
        self.check(survey(*pictures, "--fixed", "0-"), "--fixed: '0-' in '0-'", tmp_path)
        self.check(survey(pictures[0], "--reference", "7"), "marker 7 is in no view", tmp_path)
        self.check(survey(pictures[0], pictures[0]), "is given twice", tmp_path)

    def test_calibrations(self, survey, calibration, tmp_path) -> None:
        picture = take(tmp_path / "a.png", POSES[2], np.arange(3), POSITIONS_M[:3], HEADINGS_RAD[:3], seed=90)
        two = ("--camera", str(calibration))
        self.check(survey(picture, tmp_path / "b.png", *two, *two), "3 calibrations for 2 files", tmp_path)
        Image.new("L", (320, 240), 200).save(tmp_path / "small.png")
        self.check(survey(tmp_path / "small.png"), "320", tmp_path)
        Image.new("L", (800, 600), 200).save(tmp_path / "empty.png")
        self.check(survey(tmp_path / "empty.png"), "shows no marker of 4X4_50", tmp_path)
        self.check(survey(tmp_path / "gone.png"), "gone.png", tmp_path)
        self.check(survey(picture, camera=False), "--camera", tmp_path)

    def check(self, outcome, words: str, tmp_path: Path) -> None:
        code, said, _ = outcome
        assert code == 2 and words in said.err and said.err.strip().count("\n") == 0
        assert "Traceback" not in said.err and not (tmp_path / "out").exists()


def test_layout_is_learned_from_a_video(survey, tmp_path) -> None:
    """The robot turns below a slanting camera; its first second shows an empty table."""
    layout = MarkerLayout.make([3], BOX)
    pose = CameraPose((-0.8, 0.0), 0.9, 0.0, (0.0, np.radians(-38.0)))
    renderer = Renderer("4X4_50", SIDE_M, Ground(3), Sensor(2.0, np.random.default_rng(3)))
    path = tmp_path / "turn.mp4"
    with VideoSink(path, CAMERA.size_px, 10.0) as video:
        for k in range(46):
            at, turn = np.zeros((4, 2)), np.full(4, 2 * np.pi * (k - 10) / 36)
            rows = facing_rows(pose, at, turn, SIDE_M, layout.frames)
            rows = rows if k >= 10 else rows[:0]
            image = renderer.render(
                Shot(CAMERA, pose, layout.ids[rows], at[rows], turn[rows], frames=layout.frames[rows])
            )
            video.write(np.repeat(image[..., None], 3, axis=2))
    code, said, frame = survey(path, "--fixed", "3,13,23,33", "--layout", "--images", "46")
    assert code == 0 and 1 <= frame["variance_factor"] < 2, "compressed images"
    assert [one["id"] for one in frame["markers"]] == [3, 13, 23, 33]
    assert len(frame["cameras"]) == 36 and frame["cameras"][0]["picture"] == "turn 1.00 s"
    for place in BOX:
        (found,) = [one for one in frame["markers"] if one["id"] == 3 + place.add_to_id]
        true_m = SIDE_M * np.array([*place.offset_sides, place.height_sides - 1.5])
        assert np.abs(np.array(found["position_m"]) - true_m).max() < 0.002
    assert said.out.count("add_to_id") == 4


def test_video_without_marker_is_one_error(survey, tmp_path) -> None:
    path = tmp_path / "empty.mp4"
    with VideoSink(path, (800, 600), 10.0) as video:
        for _ in range(5):
            video.write(np.full((600, 800, 3), 128, np.uint8))
    code, said, _ = survey(path)
    assert code == 2 and said.err.count("\n") == 1 and "shows no marker of 4X4_50" in said.err


def test_topic_of_a_recording_is_chosen_among_several(survey, tmp_path) -> None:
    images = [
        np.asarray(
            Image.open(
                take(tmp_path / f"{k}.png", POSES[k], ids, POSITIONS_M[ids], HEADINGS_RAD[ids], seed=k)
            )
        )
        for k, ids in enumerate((np.array([0, 1, 2]), np.array([3, 4])))
    ]
    topics = ("/left/image_raw", "/right/image_raw")
    bag = write_bag(
        tmp_path / "bag", [(topic, raw(image, "mono8")) for topic, image in zip(topics, images, strict=True)]
    )
    code, said, _ = survey(bag)
    assert code == 2 and "has 2 image topics; choose one with --topic: /left/image_raw, /right" in said.err
    code, said, _ = survey(bag, "--topic", "/image")
    assert code == 2 and said.err.startswith("error: --topic: ") and "one of /left/image_raw" in said.err
    code, said, _ = survey(tmp_path / "0.png", "--topic", topics[0])
    assert (code, said.err) == (2, "error: --topic: given without a rosbag2 recording; leave it out\n")
    code, _, frame = survey(bag, tmp_path / "0.png", "--topic", topics[0])
    assert code == 0 and [one["id"] for one in frame["markers"]] == [0, 1, 2]
    code, _, frame = survey(bag, "--topic", topics[1], "--force")
    assert code == 0 and [one["id"] for one in frame["markers"]] == [3, 4]
