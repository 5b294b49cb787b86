"""Tracking of robots in drawn videos with ground truth: positions, headings, shape errors and files."""

import csv
from dataclasses import replace

import av
import cv2
import numpy as np
import pytest
from bags import raw, write_bag
from five_markers import cubes, five_markers
from scipy.spatial.transform import Rotation

from skyherd.cli import main
from skyherd.control import Template, fit_similarity
from skyherd.datasets import make_mission, shape_points
from skyherd.geometry import to_complex
from skyherd.loop import run_steps
from skyherd.markers.dictionary import load_dictionary
from skyherd.messages import Detections
from skyherd.poses.marker_poses import pose_difference
from skyherd.render import Camera, CameraPose, Ground, Renderer, Sensor, Shot
from skyherd.render.camera.camera import rotation_camera_world
from skyherd.tracking import GroundTracks, named_shape, shape_errors, track_videos
from skyherd.vision import create_detector, fuse_markers

SIZE_PX = 480, 360
"""Width and height of the images."""

SIDE_PX, CARD_PX = 36, 48
"""Side of a marker and of its white card, px."""

CORNERS = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) / 2
"""Corners of a marker of side 1 with heading -90 degrees (up in the image), front left first, in order."""


def draw(places_px, turns_rad):
    """Return an image of markers 0, 1, … at positions, each rotated from upright from +u to +v."""
    image = np.full(SIZE_PX[::-1], 190, np.uint8)
    for marker, ((u, v), turn) in enumerate(zip(places_px, turns_rad, strict=True)):
        card = np.full((CARD_PX, CARD_PX), 255, np.uint8)
        border = (CARD_PX - SIDE_PX) // 2
        inside = slice(border, border + SIDE_PX)
        card[inside, inside] = load_dictionary("4X4_50").generateImageMarker(marker, SIDE_PX)
        half = (CARD_PX - 1) / 2
        shift = cv2.getRotationMatrix2D((half, half), -np.degrees(turn), 1.0)
        shift[:, 2] += (u - half, v - half)
        cv2.warpAffine(card, shift, SIZE_PX, dst=image, borderMode=cv2.BORDER_TRANSPARENT)
    return image


def write(path, images, rate_hz=10):
    with av.open(str(path), "w") as container:
        stream = container.add_stream("libx264", rate=rate_hz, options={"crf": "12"})
        stream.width, stream.height, stream.pix_fmt = *SIZE_PX, "yuv420p"
        for image in images:
            picture = av.VideoFrame.from_ndarray(image, format="gray").reformat(format="yuv420p")
            container.mux(stream.encode(picture))
        container.mux(stream.encode(None))
    return path


PLACES_PX = np.array([[80.0, 90], [240, 60], [400, 100], [120, 280], [360, 270]])
"""Initial positions of the five robots of the video, px."""

STEP_PX = np.array([[4.0, 1], [0, 3], [-3, 2], [2, -4], [-1, -3]])
"""Motion of the robots per image, px."""

IMAGES = 6
"""Number of images of the video."""


@pytest.fixture(scope="module")
def video(tmp_path_factory):
    turns = np.linspace(0, 2, 5)
    images = [draw(PLACES_PX + k * STEP_PX, turns + 0.1 * k) for k in range(IMAGES)]
    return write(tmp_path_factory.mktemp("track") / "robots.mp4", images)


CAMERA = Camera((640, 480), focal_px=700.0)
"""The calibrated camera."""

POSE = CameraPose((-0.6, 0.1), 1.4, 0.3, (0.1, np.radians(-25.0)))
"""Its place, aslant."""


@pytest.fixture(scope="module")
def calibration(tmp_path_factory):
    path = tmp_path_factory.mktemp("calibration") / "camera.yaml"
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    storage.write("image_width", 640)
    storage.write("image_height", 480)
    storage.write("camera_matrix", CAMERA.intrinsic_matrix())
    storage.write("distortion_coefficients", np.zeros((5, 1)))
    storage.release()
    return path


def rows_of(path):
    with path.open(newline="") as stream:
        return list(csv.DictReader(stream))


def test_tracks_match_the_drawn_robots(video, tmp_path) -> None:
    track_videos([video], tmp_path / "out", detector="opencv-subpix", shape=named_shape("circle"))
    rows = rows_of(tmp_path / "out" / "tracks.csv")
    assert len(rows) == 5 * IMAGES
    middle_px = (np.array(SIZE_PX) - 1) / 2
    for row in rows:
        k, marker = int(row["frame"]), int(row["id"])
        assert float(row["time_s"]) == pytest.approx(k / 10, abs=1e-3)
        place_px = PLACES_PX[marker] + k * STEP_PX[marker]
        x_sides, y_sides = (place_px - middle_px) * (1, -1) / SIDE_PX
        # Half a pixel of compression and interpolation is 0.014 sides; sides are off by a pixel at most.
        assert float(row["x_sides"]) == pytest.approx(x_sides, abs=0.03 + abs(x_sides) / SIDE_PX)
        assert float(row["y_sides"]) == pytest.approx(y_sides, abs=0.03 + abs(y_sides) / SIDE_PX)
        heading_rad = np.pi / 2 - (np.linspace(0, 2, 5)[marker] + 0.1 * k)
        off_rad = np.angle(np.exp(1j * (np.radians(float(row["heading_deg"])) - heading_rad)))
        assert abs(off_rad) < 0.05
        assert float(row["u_px"]) == pytest.approx(place_px[0], abs=0.6)


def test_tracks_with_a_side_are_in_metres(video, tmp_path) -> None:
    for name, side_m in (("sides", None), ("metres", 0.12)):
        track_videos([video], tmp_path / name, side_m=side_m)
    sides, metres = (rows_of(tmp_path / name / "tracks.csv") for name in ("sides", "metres"))
    assert len(sides) == len(metres) == 5 * IMAGES and "x_sides" not in metres[0]
    for row, other in zip(sides, metres, strict=True):
        for axis in "xy":
            assert float(other[f"{axis}_m"]) == pytest.approx(0.12 * float(row[f"{axis}_sides"]), abs=1e-5)
            assert 0 < float(other[f"std_{axis}_m"]) < 1e-3


def test_poses_with_a_calibration_are_within_their_deviations(calibration, tmp_path, capsys) -> None:
    """The largest of 54 errors exceeds 4.5 standard deviations with a chance of 0.04 %."""
    renderer = Renderer("4X4_50", 0.1, Ground(4), Sensor(2.0, np.random.default_rng(4)))
    positions_m = np.array([[0.0, 0.0], [0.3, 0.1], [-0.2, 0.15], [0.1, -0.25]])
    headings_rad = np.array([0.3, -1.0, 2.0, 3.0])
    ids = np.array([0, 1, 2, 9])
    moves = [(positions_m + 0.03 * k, headings_rad + 0.2 * k) for k in range(3)]
    images = [renderer.render(Shot(CAMERA, POSE, ids, *move)) for move in moves]
    bag = write_bag(tmp_path / "bag", [("/camera", raw(i, "mono8", 0.1 * k)) for k, i in enumerate(images)])
    given = ("--marker-side-m", "0.1", "--camera", calibration, "--ids", "0-2", "--out", tmp_path / "out")
    assert run(bag, *given) == 0
    assert "poses.csv" in capsys.readouterr().out
    rows = rows_of(tmp_path / "out" / "poses.csv")
    assert [(row["frame"], row["id"]) for row in rows] == [
        (str(k), str(i)) for k in range(3) for i in range(3)
    ]
    turn = rotation_camera_world(POSE)
    for row in rows:
        at_m, at_rad = (part[int(row["id"])] for part in moves[int(row["frame"])])
        true_m = turn @ (np.array([*at_m, 0.0]) - np.array([*POSE.position_m, POSE.height_m]))
        true = turn @ Rotation.from_euler("z", at_rad).as_matrix()
        read = {
            name: np.array([float(row[f"{name}_{axis}_{unit}"]) for axis in "xyz"])
            for name, unit in (("camera", "m"), ("turn", "rad"), ("std_camera", "m"), ("std_turn", "rad"))
        }
        found = Rotation.from_rotvec(read["turn"]).as_matrix()
        off = pose_difference(found, read["camera"], true, true_m)
        stds = np.concatenate([read["std_camera"], read["std_turn"]])
        assert np.abs(off / stds).max() < 4.5 and stds[:3].max() < 2e-3 and row["pose"] == "plane"
    assert [row["id"] for row in rows_of(tmp_path / "out" / "tracks.csv")] == [*"012"] * 3
    # An earlier table does not survive a tracking without a calibration.
    assert run(bag, "--out", tmp_path / "out", "--force") == 0
    assert not (tmp_path / "out" / "poses.csv").exists()


def test_shape_error_matches_the_drawn_robots(video, tmp_path) -> None:
    track_videos([video], tmp_path / "out", detector="opencv-subpix", shape=named_shape("circle"))
    wanted = to_complex(shape_points("circle", 5))
    for k, row in enumerate(rows_of(tmp_path / "out" / "shape.csv")):
        places = to_complex((PLACES_PX + k * STEP_PX) * (1, -1))
        # The least-squares similarity by a linear solve, as an independent reference.
        columns = np.stack([wanted, np.ones(5)], axis=1)
        residual = places - columns @ np.linalg.lstsq(columns, places, rcond=None)[0]
        error = np.linalg.norm(residual) / np.linalg.norm(places - places.mean())
        assert float(row["shape_error"]) == pytest.approx(error, abs=2e-3) and row["robots"] == "5"
    assert (tmp_path / "out" / "tracks.png").read_bytes().startswith(b"\x89PNG")


def detections(places_px, ids, tilt=0.0):
    """Return exact detections of upright markers by a camera tilted about its u axis."""
    places_px = np.asarray(places_px, dtype=float)
    corners = places_px[:, None, :] + SIDE_PX * CORNERS
    middle = (np.array(SIZE_PX) - 1) / 2

    def seen(points):
        away = (points - middle) / 180
        return middle + 180 * away / (1 + tilt * away[..., 1:])

    corners = seen(corners)
    sides = np.sqrt(np.abs([cv2.contourArea(square.astype(np.float32)) for square in corners]))
    ahead = corners[:, :2].mean(axis=1) - corners.mean(axis=1)
    return Detections(
        unit_id=0,
        time_s=0.0,
        image_size_px=np.array(SIZE_PX, dtype=float),
        ids=np.asarray(ids),
        centers_px=seen(places_px),
        headings_rad=np.arctan2(ahead[:, 1], ahead[:, 0]),
        sides_px=sides,
        corners_px=corners,
        covariances=np.zeros((len(ids), 3, 3)),
    )


@pytest.mark.smoke
def test_camera_tilt_is_rectified() -> None:
    points = shape_points("grid", 16)
    points = (points - points.mean(axis=0)) / np.abs(points - points.mean(axis=0)).max()
    places_px = points * (1, -1) * 120 + np.array(SIZE_PX) / 2
    template = Template.from_ground_points(range(16), points)
    tracks, plain = GroundTracks("tilted"), []
    for k in range(4):
        found = detections(places_px + k, range(16), tilt=0.2)
        tracks.add(k, found)
        fit = np.stack([template.points_px, np.ones(16)], axis=1)
        seen = to_complex(found.centers_px)
        left = seen - fit @ np.linalg.lstsq(fit, seen, rcond=None)[0]
        plain.append(np.linalg.norm(left) / np.linalg.norm(seen - seen.mean()))
    assert min(plain) > 0.05, "what the tilt does"
    assert shape_errors(tracks, template).errors[1:].max() < 0.01


def test_errors_exclude_missing_unknown_and_repeated_ids() -> None:
    template = Template.from_ground_points(range(5), shape_points("circle", 5))
    places_px = shape_points("circle", 5) * (80, -80) + np.array(SIZE_PX) / 2
    tracks = GroundTracks("some")
    for ids in (range(5), range(3), range(2)):
        tracks.add(0, detections(places_px[: len(ids)], ids))
    stranger = detections(np.vstack([places_px, [[20, 20]]]), [0, 1, 2, 3, 4, 17])
    tracks.add(3, stranger)
    twice = detections(np.vstack([places_px, [[20, 20]]]), [0, 1, 2, 3, 4, 4])
    tracks.add(4, twice)
    own = GroundTracks("own", members=frozenset(range(5)))
    own.add(0, stranger)
    assert own.ids.tolist() == [0, 1, 2, 3, 4]
    errors = shape_errors(tracks, template)
    assert errors.counts.tolist() == [5, 3, 2, 5, 4] and np.isnan(errors.errors[2])
    assert np.nanmax(errors.errors) < 1e-6 and tracks.ids.tolist() == [0, 1, 2, 3, 4, 17]
    _, path = tracks.path(4)
    assert np.isfinite(path[:, 0]).tolist() == [True, False, False, True, False]


def test_missing_marker_of_another_size_moves_no_other() -> None:
    """A robot of 20 px and a sign of 40 px: without the sign, the median side of an image is less.

    In another image the robot is blurred, and seems to be 8 % larger.
    """
    places_px = np.array([[60.0, 80.0], [250.0, 180.0]])
    tracks = GroundTracks("two sizes")
    for number in range(20):
        found = detections(places_px + number, [3, 42])
        found = replace(found, sides_px=np.array([20.0 if number != 3 else 21.6, 40.0]))
        tracks.add(number, found.select([3]) if 8 <= number < 15 else found)
    _, path = tracks.path(3)
    np.testing.assert_allclose(np.diff(path, axis=0), np.diff(path, axis=0)[:1].repeat(19, axis=0), atol=1e-9)


def run(*arguments):
    with pytest.raises(SystemExit) as ended:
        main(["track", *map(str, arguments)])
    return ended.value.code


def test_track_writes_its_files_and_keeps_others(video, tmp_path, capsys) -> None:
    out = tmp_path / "out"
    empty = write(tmp_path / "empty.mp4", [np.full(SIZE_PX[::-1], 99, np.uint8)] * 2)
    assert run(video, empty, "--detector", "opencv", "--out", out) == 0
    said = capsys.readouterr()
    assert "robots.mp4" in said.out and str(out / "tracks.png") in said.out
    assert "empty.mp4: no marker found" in said.err
    assert {file.name for file in out.iterdir()} == {"tracks.csv", "tracks.png", ".skyherd.json"}
    assert run(video, "--detector", "opencv", "--out", out) == 2
    assert "exists" in capsys.readouterr().err
    (out / "tracks.csv").write_text("mine")
    assert run(video, "--detector", "opencv", "--out", out, "--force") == 2
    assert (out / "tracks.csv").read_text() == "mine"
    assert run(empty, "--detector", "opencv", "--out", tmp_path / "none") == 1


@pytest.mark.parametrize("shape", [[], ["--shape", "circle"]], ids=["alone", "shape"])
@pytest.mark.parametrize("ids", [["--ids", "7"], []], ids=["strangers", "none"])
def test_unseen_robots_are_reported_in_one_line(video, tmp_path, capsys, shape, ids) -> None:
    empty = write(tmp_path / "empty.mp4", [np.full(SIZE_PX[::-1], 99, np.uint8)] * 2)
    arguments = [video if ids else empty, *ids, *shape, "--detector", "opencv", "--out", tmp_path / "out"]
    assert run(*arguments) == 1
    said = capsys.readouterr().err
    found = "none of --ids 7 was seen; seen were 0, 1, 2, 3, 4\n" if ids else "no marker found"
    assert found in said and said.count("\n") == 1
    assert (tmp_path / "out" / "shape.csv").exists() == bool(shape)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["{video}", "--shape", "banana"], "no shape 'banana'"),
        (["{video}", "--dictionary", "5X5"], "5X5"),
        (["{video}", "--detector", "none"], "no detector 'none'"),
        (["{video}", "--ids", "0-99"], "99"),
        (["{video}", "--shape", "star", "--scenario", "star"], "one of the two"),
        (["{video}", "--scenario", "nowhere.toml"], "nowhere.toml"),
        (["{here}/none.mp4"], "no such file"),
        (["{here}/picture.png"], "not a video by its name"),
        (["{video}", "--shape", "word:SKYHERD"], "to write SKYHERD"),
        (["{video}", "--camera", "{camera}"], "both: the side is the scale"),
        (["{video}", "--camera", "{here}/none.yaml", "--marker-side-m", "0.1"], "none.yaml"),
        (["{video}", "--camera", "{camera}", "--marker-side-m", "0.1"], "640 x 480"),
    ],
)
def test_bad_input_is_one_line_and_leaves_nothing(
    arguments, words, video, calibration, tmp_path, capsys
) -> None:
    given = [text.format(video=video, camera=calibration, here=tmp_path) for text in arguments]
    assert run(*given, "--out", tmp_path / "out") == 2
    said = capsys.readouterr().err
    assert words in said and said.startswith("error: ") and said.count("\n") == 1
    assert not (tmp_path / "out").exists()


def test_robots_with_several_markers_have_one_track_each() -> None:
    """Tracks of the reference points agree with the true ones up to a similarity of the ground."""
    mission = make_mission(five_markers() | {"duration_s": 0.3})
    tracks = GroundTracks("five")
    detector = create_detector("photometric")
    steps = list(run_steps(mission))
    for number, step in enumerate(steps):
        found = detector.detect(step.frames[0].sight.image, time_s=step.time_s)
        tracks.add(number, fuse_markers(found, mission.layout))
    assert tracks.ids.tolist() == mission.ids.tolist()
    for sighting, step in zip(tracks.sightings, steps, strict=True):
        order = np.argsort(sighting.seen.ids)
        found, true = to_complex(sighting.positions[order]), to_complex(step.positions_m)
        similarity = fit_similarity(found, true)
        assert abs(similarity(found) - true).max() < 0.02 * mission.scenario.marker.side_m
        assert similarity.scale == pytest.approx(mission.scenario.marker.side_m, rel=0.01)


def test_cubes_of_a_scenario_are_tracked_on_the_ground(tmp_path) -> None:
    """The images are in a bag, which loses nothing."""
    mission = make_mission(cubes() | {"duration_s": 0.2})
    steps = list(run_steps(mission))
    messages = [("/camera", raw(step.frames[0].sight.image, "mono8", step.time_s)) for step in steps]
    bag = write_bag(tmp_path / "bag", messages)
    side_m = mission.scenario.marker.side_m
    (tracks,) = track_videos([bag], tmp_path / "out", layout=mission.layout, side_m=side_m)
    assert tracks.ids.tolist() == mission.ids.tolist()
    for sighting, step in zip(tracks.sightings, steps, strict=True):
        order = np.argsort(sighting.seen.ids)
        found, true = to_complex(sighting.positions[order]), to_complex(step.positions_m)
        similarity = fit_similarity(found, true)
        assert abs(similarity(found) - true).max() < 0.05 * side_m
        assert similarity.scale == pytest.approx(1.0, rel=0.02)
