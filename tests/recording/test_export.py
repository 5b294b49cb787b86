"""Exports against the recorded messages, as read by programs that know nothing of skyherd."""

import csv
import json
import sys
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pandas
import pyarrow.parquet
import pytest
from command_line import assert_refused, call
from live_sessions import BEGUN_S, Script, small_lab
from pycocotools.coco import COCO
from rosbags.highlevel import AnyReader
from scipy.spatial.transform import Rotation
from sightings import make_sighting

from skyherd.analysis.goal_points import desired_points_px
from skyherd.cli import choices
from skyherd.datasets import load_mission
from skyherd.errors import OutputError
from skyherd.files.folder_record import RECORD
from skyherd.files.image_streams import open_stream, read_stream
from skyherd.live.logs.process_log import ProcessLog
from skyherd.live.review import read_live_run
from skyherd.loop import run_steps
from skyherd.messages import UnitReport
from skyherd.recording.export import FORMATS, export_run, read_simulated
from skyherd.recording.export.tables import SIMULATED_TABLES, tables_of
from skyherd.recording.writer import McapRecorder
from skyherd.render import homography_image_ground
from skyherd.vision import create_detector

STEPS = 4
"""Recorded steps."""


@pytest.fixture(scope="module")
def mission():
    return load_mission("triangle", [f"duration_s={(STEPS - 1) * 0.1}", "units.0.tilt_deg=[6.0, -4.0]"])


@pytest.fixture(scope="module")
def steps(mission):
    return list(run_steps(mission))


@pytest.fixture(scope="module")
def run_folder(mission, steps, tmp_path_factory):
    folder = tmp_path_factory.mktemp("runs") / "tri"
    folder.mkdir()
    with McapRecorder(folder / "run.mcap", mission, images=True) as recorder:
        for step in steps:
            recorder.write(step)
        recorder.finish(steps[-1].time_s, 1.0)
    return folder


@pytest.fixture(scope="module")
def exported(run_folder, tmp_path_factory):
    """Return a folder with an export in each format, by the name of the format."""
    folder = tmp_path_factory.mktemp("exports")
    run = read_simulated(run_folder / "run.mcap", "tri")
    for kind in FORMATS:
        export_run(run, folder / kind, kind)
    return folder


def read_csv(path: Path) -> pandas.DataFrame:
    """Read a CSV file with exact numbers; pandas itself rounds the last digit in some versions."""
    with path.open(newline="", encoding="utf-8") as stream:
        names, *rows = csv.reader(stream)
    return pandas.DataFrame([[cell(text) for text in row] for row in rows], columns=names)


def cell(text: str) -> float | bool | str | None:
    if text in ("", "true", "false"):
        return {"": None, "true": True, "false": False}[text]
    try:
        return float(text)
    except ValueError:
        return text


def frames_of(steps):
    return [frame for step in steps for frame in step.frames.values()]


class TestTables:
    def test_csv_has_every_digit_of_the_detections(self, exported, steps) -> None:
        table = read_csv(exported / "csv" / "detections.csv")
        wanted = pandas.concat([frame.sight.detections.to_dataframe() for frame in frames_of(steps)])
        assert len(table) > 6 * (STEPS - 1)
        # Times are recorded as integer ns, and standard deviations are in degrees.
        for column in ("time_s", "std_u_px", "std_v_px", "std_heading_deg", "heading_deg"):
            np.testing.assert_allclose(table[column], wanted.pop(column), rtol=1e-14, atol=1e-9)
        for column in wanted.columns:
            np.testing.assert_array_equal(table[column], wanted[column], err_msg=column)

    def test_covariances_in_degrees_form_the_matrix(self, exported, steps) -> None:
        table = read_csv(exported / "csv" / "detections.csv")
        found = frames_of(steps)[0].sight.detections
        for row, covariance in enumerate(found.covariances):
            scaled = covariance * np.outer((1, 1, 180 / np.pi), (1, 1, 180 / np.pi))
            stds = table.loc[row, ["std_u_px", "std_v_px", "std_heading_deg"]]
            np.testing.assert_allclose(stds.astype(float) ** 2, np.diag(scaled))
            assert table.loc[row, "cov_u_v_px2"] == pytest.approx(scaled[0, 1])
            assert table.loc[row, "cov_u_heading_px_deg"] == pytest.approx(scaled[0, 2])
            assert table.loc[row, "cov_v_heading_px_deg"] == pytest.approx(scaled[1, 2])

    def test_decisions_and_truth_are_the_recorded_ones(self, exported, steps) -> None:
        def column(table, name):
            return read_csv(exported / "csv" / f"{table}.csv")[name]

        goals = [frame.decision.goals for frame in frames_of(steps)]
        np.testing.assert_array_equal(column("goals", "rho_px"), np.concatenate([g.rho_px for g in goals]))
        np.testing.assert_array_equal(column("goals", "robot_id"), np.concatenate([g.ids for g in goals]))
        bearings = np.radians(column("goals", "bearing_deg"))
        np.testing.assert_allclose(bearings, np.concatenate([g.bearings_rad for g in goals]))
        commands = [step.command for step in steps]
        np.testing.assert_array_equal(
            column("commands", "v_mps"), np.concatenate([c.v_mps for c in commands])
        )
        places = np.concatenate([step.positions_m for step in steps])
        np.testing.assert_array_equal(column("true_robots", "x_m"), places[:, 0])
        np.testing.assert_array_equal(column("metrics", "lyapunov_m2"), [step.metrics.V for step in steps])
        climbs = [frame.decision.flight.climb_mps for frame in frames_of(steps)]
        np.testing.assert_array_equal(column("flights", "climb_mps"), climbs)

    @pytest.mark.parametrize("name", [spec.name for spec in tables_of("simulated")])
    def test_parquet_equals_csv_and_names_meanings(self, exported, name) -> None:
        table = pyarrow.parquet.read_table(exported / "parquet" / f"{name}.parquet")
        text = read_csv(exported / "csv" / f"{name}.csv")
        assert table.column_names == list(text.columns)
        assert all(field.metadata[b"meaning"] for field in table.schema)
        binary = table.to_pandas()
        for column in text.columns:
            if len(text) and text[column].notna().all():
                np.testing.assert_array_equal(binary[column], text[column], err_msg=column)
            else:
                assert binary[column].isna().sum() == text[column].isna().sum()

    def test_unknown_covariance_is_null_in_both(self, mission, steps, tmp_path) -> None:
        frame = frames_of(steps)[0]
        blind = replace(frame.sight.detections, covariances=np.zeros((len(frame.sight.detections), 3, 3)))
        step = replace(steps[0], frames={0: replace(frame, sight=replace(frame.sight, detections=blind))})
        with McapRecorder(tmp_path / "run.mcap", mission) as recorder:
            recorder.write(step)
        run = read_simulated(tmp_path / "run.mcap", "blind")
        for kind in ("csv", "parquet"):
            export_run(run, tmp_path / kind, kind)
        table = read_csv(tmp_path / "csv" / "detections.csv")
        assert table["std_u_px"].isna().all() and table["cov_u_v_px2"].isna().all()
        columns = pyarrow.parquet.read_table(tmp_path / "parquet" / "detections.parquet")
        assert columns["std_u_px"].null_count == len(table) and columns["u_px"].null_count == 0

    def test_description_explains_every_column(self, exported) -> None:
        about = json.loads((exported / "csv" / "about.json").read_text())
        for spec in tables_of("simulated"):
            with (exported / "csv" / f"{spec.name}.csv").open(newline="") as stream:
                assert list(about["tables"][spec.name]["columns"]) == next(csv.reader(stream))
        assert about["configuration"]["name"] == "triangle" and about["flaws"] == []


class Bag:
    """Messages of a bag by topic, as decoded by the definitions inside of it."""

    def __init__(self, folder: Path) -> None:
        self.by_topic: dict[str, list] = {}
        self.logged_ns: dict[str, list[int]] = {}
        with AnyReader([folder]) as reader:
            for connection, logged_ns, data in reader.messages():
                message = reader.deserialize(data, connection.msgtype)
                self.by_topic.setdefault(connection.topic, []).append(message)
                self.logged_ns.setdefault(connection.topic, []).append(logged_ns)

    def transforms(self, row: int) -> dict[str, tuple[np.ndarray, Rotation]]:
        """Return place and attitude of each frame in one message of /tf."""
        found = {}
        for entry in self.by_topic["/tf"][row].transforms:
            t, q = entry.transform.translation, entry.transform.rotation
            assert entry.header.frame_id == "map"
            found[entry.child_frame_id] = np.array([t.x, t.y, t.z]), Rotation.from_quat([q.x, q.y, q.z, q.w])
        return found


@pytest.fixture(scope="module")
def bag(exported):
    return Bag(exported / "rosbag2")


class TestRosbag:
    def test_images_are_read_back_from_the_bag(self, exported, steps) -> None:
        """A JPEG of the quality of recordings is within a few grey levels of its image."""
        clip = open_stream(exported / "rosbag2")
        images = [frame.sight.image for frame in frames_of(steps)]
        for frame, image in zip(read_stream(clip), images, strict=True):
            assert abs(frame.image.astype(float) - image).mean() < 4
        assert clip.topic == "/unit_0/image/compressed"

    def test_detections_have_pose_and_covariance(self, bag, steps) -> None:
        messages = bag.by_topic["/unit_0/detections"]
        for message, frame in zip(messages, frames_of(steps), strict=True):
            found = frame.sight.detections
            assert [int(entry.id) for entry in message.detections] == found.ids.tolist()
            for entry, marker in zip(message.detections, found, strict=True):
                pose = entry.results[0].pose
                place = pose.pose.position
                np.testing.assert_array_equal([place.x, place.y], marker.center_px)
                covariance = pose.covariance.reshape(6, 6)
                np.testing.assert_array_equal(covariance[np.ix_([0, 1, 5], [0, 1, 5])], marker.covariance)
                assert covariance.sum() == pytest.approx(marker.covariance.sum())
                q = pose.pose.orientation
                turn = Rotation.from_quat([q.x, q.y, q.z, q.w]).as_euler("xyz")
                np.testing.assert_allclose(turn, [0, 0, marker.heading_rad], atol=1e-12)
                assert entry.results[0].hypothesis.class_id == str(marker.id)
                assert entry.bbox.size_x == marker.side_px

    def test_true_frames_project_onto_the_detections(self, bag, mission) -> None:
        """The transforms of a tilted camera and of the robots predict the detections by a pinhole camera."""
        camera = mission.scenario.units[0].camera.make()
        places = bag.transforms(0)
        camera_place, attitude = places["unit_0"]
        for entry in bag.by_topic["/unit_0/detections"][0].detections:
            place, turn = places[f"robot_{entry.id}"]
            ray = attitude.inv().apply(place - camera_place)
            u, v = (camera.intrinsic_matrix() @ (ray / ray[2]))[:2]
            center = entry.bbox.center
            assert np.hypot(u - center.position.x, v - center.position.y) < 0.05
            ahead = attitude.inv().apply(place + turn.apply([1e-3, 0, 0]) - camera_place)
            step = (camera.intrinsic_matrix() @ (ahead / ahead[2]))[:2] - [u, v]
            assert abs(np.angle(np.exp(1j * (np.arctan2(*step[::-1]) - center.theta)))) < 0.01

    def test_goals_lie_on_the_desired_points(self, bag, mission, steps) -> None:
        """In a robot's frame a goal is the ground point whose image is the desired point."""
        frame = steps[0].frames[0]
        goals = frame.decision.goals
        camera = mission.scenario.units[0].camera.make()
        pose = steps[0].fleet.pose(0)
        ground = np.linalg.inv(homography_image_ground(camera, pose))
        for robot, (u, v) in zip(goals.ids.tolist(), desired_points_px(frame.decision), strict=True):
            x, y, w = ground @ [u, v, 1.0]
            place, turn = bag.transforms(0)[f"robot_{robot}"]
            goal = bag.by_topic[f"/unit_0/robot_{robot}/goal"][0]
            assert goal.header.frame_id == f"robot_{robot}"
            there = place + turn.apply([goal.point.x, goal.point.y, goal.point.z])
            distance_m = np.hypot(goal.point.x, goal.point.y)
            # The unit estimates the ground without calibration.
            assert np.hypot(*(there[:2] - [x / w, y / w])) < 0.05 * distance_m + 0.02

    def test_flight_commands_move_the_camera_frame(self, bag) -> None:
        """A unit's twist is the velocity of its frame, by the differences of true poses."""
        (place, attitude), (later, turned) = (bag.transforms(row)["unit_0"] for row in (0, 1))
        twist = bag.by_topic["/unit_0/cmd_vel"][0].twist
        speed = np.array([twist.linear.x, twist.linear.y, twist.linear.z])
        assert np.linalg.norm(speed) > 0.1
        # The autopilot flies in the axes of an untilted camera.
        yaw = np.arctan2(*attitude.as_matrix()[1::-1, 0])
        level = np.array([[np.cos(yaw), np.sin(yaw), 0], [np.sin(yaw), -np.cos(yaw), 0], [0, 0, -1.0]])
        np.testing.assert_allclose((later - place) / 0.1, level.T @ speed, atol=0.03)
        yaws = [np.arctan2(*frame.as_matrix()[1::-1, 0]) for frame in (attitude, turned)]
        assert -twist.angular.z == pytest.approx((yaws[1] - yaws[0]) / 0.1, rel=0.1)

    def test_wheel_commands_and_states_are_the_recorded(self, bag, steps) -> None:
        for row, robot in enumerate(steps[0].command.ids.tolist()):
            twists = [message.twist for message in bag.by_topic[f"/robot_{robot}/cmd_vel"]]
            assert [twist.linear.x for twist in twists] == [step.command.v_mps[row] for step in steps]
            assert [t.angular.z for t in twists] == [step.command.omega_radps[row] for step in steps]
            assert [message.data for message in bag.by_topic[f"/robot_{robot}/state"]] == ["driving"]

    def test_images_are_the_recorded_bytes(self, bag, exported, steps) -> None:
        pictures = bag.by_topic["/unit_0/image/compressed"]
        files = sorted((exported / "coco" / "images" / "unit_0").iterdir())
        assert len(pictures) == len(files) == len(steps)
        for picture, file, frame in zip(pictures, files, frames_of(steps), strict=True):
            assert picture.data.tobytes() == file.read_bytes()
            image = cv2.imdecode(picture.data, cv2.IMREAD_GRAYSCALE)
            assert cv2.absdiff(image, frame.sight.image).mean() < 2.0

    def test_times_are_those_of_the_steps(self, bag, steps) -> None:
        wanted = [round(step.time_s * 1e9) for step in steps]
        assert bag.logged_ns["/tf"] == bag.logged_ns["/unit_0/detections"] == wanted
        stamps = [message.header.stamp for message in bag.by_topic["/unit_0/detections"]]
        assert [stamp.sec * 10**9 + stamp.nanosec for stamp in stamps] == wanted


class TestCoco:
    @pytest.mark.filterwarnings("ignore:__array__ implementation:DeprecationWarning")
    def test_pycocotools_reads_images_and_outlines(self, exported, steps, capsys) -> None:
        coco = COCO(exported / "coco" / "annotations.json")
        capsys.readouterr()
        assert len(coco.imgs) == len(steps) and coco.loadCats(1)[0]["name"] == "marker"
        assert len(coco.anns) == sum(len(frame.sight.detections) for frame in frames_of(steps))
        for entry in coco.anns.values():
            # Pixels along the outline count as a whole or not at all.
            assert abs(int(coco.annToMask(entry).sum()) - entry["area"]) < 4 * np.sqrt(entry["area"])
            left, top, width, height = entry["bbox"]
            u, v = entry["keypoints"][12:14]
            assert left < u < left + width and top < v < top + height

    def test_detector_finds_annotated_markers_in_images(self, exported) -> None:
        """COCO's pixel centres are at halves, ours at integers."""
        document = json.loads((exported / "coco" / "annotations.json").read_text())
        image = document["images"][0]
        grey = cv2.imread(str(exported / "coco" / "images" / image["file_name"]), cv2.IMREAD_GRAYSCALE)
        assert grey.shape == (image["height"], image["width"])
        found = {marker.id: marker.center_px for marker in create_detector("photometric").detect(grey)}
        entries = [entry for entry in document["annotations"] if entry["image_id"] == image["id"]]
        assert len(entries) == 6
        for entry in entries:
            u, v = entry["keypoints"][12:14]
            assert np.hypot(*(found[entry["marker_id"]] - [u - 0.5, v - 0.5])) < 0.1

    def test_marker_outside_the_image_has_no_annotation(self, mission, steps, tmp_path) -> None:
        frame = frames_of(steps)[0]
        found = frame.sight.detections
        shift = np.zeros((len(found), 2))
        shift[0], shift[1] = [-5000.0, 0.0], [-found.centers_px[1, 0], 0.0]
        moved = replace(
            found, centers_px=found.centers_px + shift, corners_px=found.corners_px + shift[:, None]
        )
        step = replace(steps[0], frames={0: replace(frame, sight=replace(frame.sight, detections=moved))})
        with McapRecorder(tmp_path / "run.mcap", mission) as recorder:
            recorder.write(step)
        export_run(read_simulated(tmp_path / "run.mcap", "moved"), tmp_path / "out", "coco")
        entries = json.loads((tmp_path / "out" / "annotations.json").read_text())["annotations"]
        assert [entry["marker_id"] for entry in entries] == found.ids[1:].tolist()
        assert entries[0]["visible_fraction"] == pytest.approx(0.5, abs=0.05)
        assert entries[0]["bbox"][0] == 0 and entries[0]["num_keypoints"] < 5


@pytest.fixture(scope="module")
def script():
    return Script(lab=small_lab(cameras=2), images=5, clock_offset_s=7.5)


@pytest.fixture(scope="module")
def live_folder(script, tmp_path_factory):
    """Return a folder of one script, and of a second unit that sends goals and a report."""
    folder = script.write(tmp_path_factory.mktemp("live") / "run")
    captured_s, found_s, sent_s = BEGUN_S + 0.05, BEGUN_S + 0.06, BEGUN_S + 0.07
    goals = replace(script.goals(0), unit_id=1, time_s=captured_s)
    report = UnitReport(
        1, captured_s, np.array([640, 480]), np.array([2]), np.zeros((1, 2)), np.array([2, 0]), np.array([0])
    )  # fmt: skip
    with ProcessLog(folder / "unit_1.mcap", "unit/1", script.lab, BEGUN_S) as log:
        log.saw(replace(empty_detections(), unit_id=1, time_s=captured_s), found_s)
        messages = (make_sighting(captured_s, np.array([2]), unit=1), goals, report)
        log.put("/sent", sent_s, {"messages": messages})
        log.put("/end", sent_s, {})
    return folder


def empty_detections():
    from skyherd.messages import Detections

    none = np.zeros(0)
    return Detections(
        unit_id=0, time_s=0.0, image_size_px=np.array([640, 480]), ids=np.zeros(0, int),
        centers_px=none.reshape(0, 2), headings_rad=none, sides_px=none, corners_px=none.reshape(0, 4, 2),
        covariances=none.reshape(0, 3, 3),
    )  # fmt: skip


class TestLiveRun:
    def test_tables_share_one_clock(self, script, live_folder, tmp_path, capsys) -> None:
        """The robots' clocks are 7.5 s ahead of the unit's."""
        code, _, err = call(capsys, "export", live_folder, "--out", tmp_path / "out")
        assert (code, err) == (0, "")
        commands = read_csv(tmp_path / "out" / "commands.csv")
        assert not {f"{spec.name}.csv" for spec in SIMULATED_TABLES} & {
            path.name for path in (tmp_path / "out").iterdir()
        }
        for row, robot in enumerate(script.lab.ids):
            mine = commands[commands["robot_id"] == robot]
            np.testing.assert_allclose(mine["time_s"], script.commanded_s[:, row] - BEGUN_S, atol=1e-3)
            assert mine["armed"].all() and (mine["state"] == "driving").all()
        assert commands["time_s"].is_monotonic_increasing
        images = read_csv(tmp_path / "out" / "images.csv")
        first = images[images["unit_id"] == 0]
        np.testing.assert_allclose(first["time_s"], script.captured_s - BEGUN_S, atol=1e-6)
        np.testing.assert_allclose(first["decided_s"], script.passed_s[:, 3] - BEGUN_S, atol=1e-6)
        about = json.loads((tmp_path / "out" / "about.json").read_text())
        assert about["start_unix_s"] == BEGUN_S and about["configuration"]["team"] == "small"

    def test_goals_and_control_sets_are_those_sent(self, live_folder, script, tmp_path) -> None:
        export_run(read_live_run(live_folder), tmp_path / "out", "csv")
        goals = read_csv(tmp_path / "out" / "goals.csv")
        assert goals["robot_id"].tolist() == list(script.lab.ids)
        np.testing.assert_allclose(goals["time_s"], 0.05, atol=1e-6)
        controlled = read_csv(tmp_path / "out" / "controlled.csv")
        assert controlled["robot_id"].tolist() == [2, 0]
        assert controlled["secure"].tolist() == [False, True]

    def test_bag_is_stamped_with_the_time_of_day(self, live_folder, script, tmp_path) -> None:
        export_run(read_live_run(live_folder), tmp_path / "out", "rosbag2")
        bag = Bag(tmp_path / "out")
        stamps = [message.header.stamp for message in bag.by_topic["/unit_0/detections"]]
        found_s = [stamp.sec + stamp.nanosec * 1e-9 for stamp in stamps]
        np.testing.assert_allclose(found_s, script.captured_s, atol=1e-5)
        np.testing.assert_allclose(
            bag.logged_ns["/unit_0/detections"], script.passed_s[:, 3] * 1e9, rtol=0, atol=1e4
        )
        assert "/tf" not in bag.by_topic

    def test_malformed_record_ends_only_its_process(self, live_folder, script, tmp_path, capsys) -> None:
        bent = tmp_path / "run"
        bent.mkdir()
        for path in live_folder.iterdir():
            (bent / path.name).write_bytes(path.read_bytes())
        with ProcessLog(bent / "robot_0.mcap", "robot/0", script.lab, BEGUN_S) as log:
            script.write_decision(log, 0, 0, 0)
            log.put("/decide", BEGUN_S + 1, {"order": {"reason": "x", "v_mps": "fast"}, "armed": True})
        code, _, err = call(capsys, "export", bent, "--out", tmp_path / "out")
        assert code == 0 and err.count("\n") == 1 and "robot_0.mcap: its records" in err
        commands = read_csv(tmp_path / "out" / "commands.csv")
        counts = commands["robot_id"].value_counts().to_dict()
        assert counts == {0: 1, 1: script.images, 2: script.images}


class TestWholeOrNothing:
    @pytest.mark.parametrize("kind", FORMATS)
    def test_interrupted_export_leaves_nothing(self, run_folder, tmp_path, kind) -> None:
        run = read_simulated(run_folder / "run.mcap", "tri")
        names, moments = [], run.moments

        def broken():
            yield from list(moments())[:-3]
            names.extend(path.name for path in (tmp_path / "out").rglob("*") if path.is_file())
            raise OutputError("disk full")

        run.moments = broken
        with pytest.raises(OutputError, match="disk full"):
            export_run(run, tmp_path / "out", kind)
        finished = {"metadata.yaml", "annotations.json", "about.json", f"detections.{kind}"}
        assert names and not finished & set(names)
        assert list(tmp_path.iterdir()) == []

    @pytest.mark.parametrize("kind", FORMATS)
    def test_forced_export_replaces_every_former_file(self, run_folder, exported, tmp_path, kind) -> None:
        run = read_simulated(run_folder / "run.mcap", "tri")
        export_run(run, tmp_path / "out", "coco")
        left = tmp_path / "out" / ".skyherd-0123456789abcdef.part"
        left.mkdir()
        (left / "bag.mcap").write_bytes(b"of a killed process")
        (tmp_path / "out" / "mine.txt").write_text("precious")
        export_run(run, tmp_path / "out", kind, force=True)
        made = {str(path.relative_to(tmp_path / "out")) for path in (tmp_path / "out").rglob("*.*")}
        wanted = {str(path.relative_to(exported / kind)) for path in (exported / kind).rglob("*.*")}
        assert {name for name in made if not name.startswith("images")} - {"mine.txt"} == {
            name for name in wanted if not name.startswith("images")
        }
        assert (tmp_path / "out" / "mine.txt").read_text() == "precious"

    def test_stale_images_do_not_survive(self, mission, steps, run_folder, tmp_path) -> None:
        export_run(read_simulated(run_folder / "run.mcap", "tri"), tmp_path / "out", "coco")
        with McapRecorder(tmp_path / "run.mcap", mission) as recorder:
            recorder.write(steps[0])
        export_run(read_simulated(tmp_path / "run.mcap", "short"), tmp_path / "out", "coco", force=True)
        assert not (tmp_path / "out" / "images").exists()


class TestCommand:
    @pytest.mark.smoke
    @pytest.mark.parametrize("kind", FORMATS)
    def test_export_writes_the_named_file(self, run_folder, tmp_path, monkeypatch, capsys, kind) -> None:
        monkeypatch.chdir(tmp_path)
        code, out, err = call(capsys, "export", run_folder, "--format", kind)
        assert (code, err) == (0, "")
        assert Path(out.splitlines()[-1].removeprefix("see ")).is_file()
        assert (tmp_path / "exports" / f"tri-{kind}" / RECORD).is_file()

    def test_offered_formats_are_the_known_ones(self) -> None:
        assert choices.EXPORT_FORMATS == FORMATS

    @pytest.mark.parametrize(("kind", "module", "extra"), [
        ("parquet", "pyarrow", "export"), ("rosbag2", "rosbags.rosbag2", "ros"),
    ])  # fmt: skip
    def test_missing_library_is_one_line(
        self, run_folder, tmp_path, monkeypatch, capsys, kind, module, extra
    ) -> None:
        monkeypatch.setitem(sys.modules, module, None)
        refused = call(capsys, "export", run_folder, "--format", kind, "--out", tmp_path / "out")
        assert_refused(refused, f"--format: {kind}: ", f"pip install 'skyherd[{extra}]'")
        assert not (tmp_path / "out").exists()

    def test_wrong_inputs_are_refused_in_one_line(self, run_folder, tmp_path, capsys) -> None:
        refused = call(capsys, "export", run_folder, "--format", "cvs", "--out", tmp_path / "out")
        assert_refused(refused, "--format: no format 'cvs'; did you mean 'csv'?")
        assert_refused(call(capsys, "export", tmp_path / "none"), "no such folder")
        assert_refused(
            call(capsys, "export", run_folder / "run.mcap"), f"give its folder: `skyherd export {run_folder}`"
        )
        (tmp_path / "mine").mkdir()
        (tmp_path / "mine" / "detections.csv").write_text("precious")
        refused = call(capsys, "export", run_folder, "--out", tmp_path / "mine", "--force")
        assert_refused(refused, "detections.csv: was not made by skyherd")
        assert_refused(call(capsys, "export", run_folder, "--out", tmp_path / "mine"), "exists")

    def test_cut_recording_is_exported_with_a_warning(self, run_folder, tmp_path, capsys) -> None:
        data = (run_folder / "run.mcap").read_bytes()
        (tmp_path / "cut").mkdir()
        (tmp_path / "cut" / "run.mcap").write_bytes(data[: len(data) * 3 // 4])
        code, _, err = call(capsys, "export", tmp_path / "cut", "--out", tmp_path / "out")
        assert code == 0 and "cut short" in err and err.count("\n") == 1
        images = read_csv(tmp_path / "out" / "images.csv")
        assert 0 < len(images) < STEPS
        assert json.loads((tmp_path / "out" / "about.json").read_text())["flaws"]

    def test_coco_without_images_says_how_to_get_them(self, mission, steps, tmp_path, capsys) -> None:
        with McapRecorder(tmp_path / "run.mcap", mission) as recorder:
            for step in steps:
                recorder.write(step)
            recorder.finish(steps[-1].time_s, 1.0)
        code, _, err = call(capsys, "export", tmp_path, "--format", "coco", "--out", tmp_path / "out")
        assert code == 0 and "--record-images" in err
        assert not (tmp_path / "out" / "images").exists()
