"""`skyherd dataset`: its check finds each kind of damage, and each user error has one line."""

import csv
import json
import shutil

import cv2
import numpy as np
import pytest
from command_line import assert_refused, call
from label_specs import spec_of

from skyherd.datasets.labelled.check import check_dataset
from skyherd.datasets.labelled.formats.truth_table import table_text
from skyherd.datasets.labelled.make import make_dataset

IMAGE = "images/train/000000.png"


@pytest.fixture(scope="module")
def good(tmp_path_factory):
    folder = tmp_path_factory.mktemp("sets") / "good"
    return make_dataset(spec_of(), folder).path


@pytest.fixture(scope="module")
def few(tmp_path_factory):
    """Make the first images of the valid set: four are enough to find any damage."""
    folder = tmp_path_factory.mktemp("sets") / "few"
    return make_dataset(spec_of(images=4), folder).path


@pytest.fixture
def copy(few, tmp_path):
    return shutil.copytree(few, tmp_path / "copy")


def test_a_good_set_passes(good):
    verdict = check_dataset(good)
    assert verdict.problems == []
    assert verdict.images == 10
    found = verdict.agreement
    assert found.images == 10
    assert found.clear > 10
    assert found.recall > 0.9
    assert found.rmse_px < 0.5 and found.rmse_deg < 1.0


def _missing(folder):
    (folder / IMAGE).unlink()


def _truncated(folder):
    data = (folder / IMAGE).read_bytes()
    (folder / IMAGE).write_bytes(data[: len(data) // 2])


def _wrong_size(folder):
    cv2.imwrite(str(folder / IMAGE), np.zeros((240, 319), np.uint8))


def _another_image(folder):
    shutil.copy(folder / "images/train/000001.png", folder / IMAGE)


def _moved_yolo(folder):
    file = folder / "labels/train/000000.txt"
    words = file.read_text().split(" ")
    words[1] = str(float(words[1]) + 0.01)
    file.write_text(" ".join(words))


def _missing_yolo(folder):
    (folder / "labels/train/000000.txt").unlink()


def _short_yolo(folder):
    file = folder / "labels/train/000000.txt"
    file.write_text("".join(file.read_text().splitlines(keepends=True)[:-1]))


def _garbled_yolo(folder):
    (folder / "labels/train/000000.txt").write_text("0 a b\n")


def _no_yaml(folder):
    (folder / "data.yaml").unlink()


def _wrong_yaml(folder):
    file = folder / "data.yaml"
    file.write_text(file.read_text().replace("train: ", "path: ", 1))


def _change_coco(folder, change):
    file = folder / "annotations/train.json"
    document = json.loads(file.read_text())
    change(document)
    file.write_text(json.dumps(document))


def _moved_coco(folder):
    def change(document):
        document["annotations"][1]["keypoints"][0] += 0.5

    _change_coco(folder, change)


def _short_coco(folder):
    _change_coco(folder, lambda document: document["annotations"].pop())


def _garbled_coco(folder):
    _change_coco(folder, lambda document: document.update(images=[7], annotations="?"))


def _other_text_coco(folder):
    file = folder / "annotations/train.json"
    file.write_text(json.dumps(json.loads(file.read_text()), indent=1))


def _cut_coco(folder):
    file = folder / "annotations/train.json"
    file.write_text(file.read_text()[:200])


def _deep_coco(folder):
    (folder / "annotations/train.json").write_text("[" * 100_000)


def _moved_truth(folder):
    """Move a marker in the table alone; both formats and seed differ from it."""
    file = folder / "truth.csv"
    lines = file.read_text().splitlines()
    words = lines[1].split(",")
    words[2] = str(float(words[2]) + 3)
    file.write_text("\n".join([lines[0], ",".join(words), *lines[2:]]))


def _short_truth(folder):
    file = folder / "truth.csv"
    file.write_text("\n".join(file.read_text().splitlines()[:-1]) + "\n")


def _no_number(folder):
    file = folder / "truth.csv"
    lines = file.read_text().splitlines()
    file.write_text("\n".join([lines[0], lines[1] + "x", *lines[2:]]))


def _painted_over(folder):
    """Paint a grey square of 20 px over a marker: too small to change the image's mean noticeably."""
    with (folder / "truth.csv").open() as stream:
        rows = [row for row in csv.DictReader(stream) if row["image"] == IMAGE]
    row = min(rows, key=lambda row: (-float(row["visible_fraction"]), float(row["side_px"])))
    u, v, half = (float(row[name]) for name in ("u_px", "v_px", "side_px"))
    image = cv2.imread(str(folder / IMAGE), cv2.IMREAD_GRAYSCALE)
    half = min(half / 2, 10)
    corners = [max(0, round(value)) for value in (v - half, v + half, u - half, u + half)]
    image[corners[0] : corners[1], corners[2] : corners[3]] = 128
    cv2.imwrite(str(folder / IMAGE), image)


def _added_image(folder):
    shutil.copy(folder / IMAGE, folder / "images/train/holiday.png")


def _change_images_table(folder, column, value):
    with (folder / "images.csv").open() as stream:
        rows = list(csv.DictReader(stream))
    rows[0][column] = value
    (folder / "images.csv").write_text(table_text(rows, rows[0]))


def _nan_in_images(folder):
    _change_images_table(folder, "focal_u_px", "nan")


def _another_camera(folder):
    _change_images_table(folder, "height_sides", "7.0")


def _long_row(folder):
    file = folder / "images.csv"
    file.write_text(file.read_text().replace("\n", ",1\n").replace(",1\n", "\n", 1))


def _nan_in_truth(folder):
    file = folder / "truth.csv"
    lines = file.read_text().splitlines()
    words = lines[1].split(",")
    words[2] = "nan"
    file.write_text("\n".join([lines[0], ",".join(words), *lines[2:]]))


def _no_table(folder):
    (folder / "images.csv").unlink()


DAMAGES = {
    _painted_over: (IMAGE, "its pixels around"),
    _added_image: ("holiday.png", "is not a file of the set"),
    _nan_in_images: ("images.csv", "focal_u_px is nan"),
    _another_camera: ("images.csv", "height_sides is not as its seed gives it"),
    _long_row: ("images.csv", "longer or shorter"),
    _nan_in_truth: ("line 2", "not all of its values are numbers"),
    _missing: (IMAGE, "no such file"),
    _truncated: (IMAGE, "damaged or cut short"),
    _wrong_size: (IMAGE, "319x240 px, its spec says 320x240"),
    _another_image: (IMAGE, "not those of its seed"),
    _moved_yolo: ("000000.txt", "line 1, value 2 is 0."),
    _missing_yolo: ("000000.txt", "no such file"),
    _short_yolo: ("000000.txt", "lines instead of"),
    _garbled_yolo: ("000000.txt", "line 1, value 2 is a instead of 0."),
    _no_yaml: ("data.yaml", "no such file"),
    _wrong_yaml: ("data.yaml", "differs from its spec: line 3, value 1 is path: instead of train:"),
    _moved_coco: ("train.json", "annotations.1.keypoints.0 is"),
    _short_coco: ("train.json", "annotations has"),
    _garbled_coco: ("train.json", "images has 1 entries instead of 3"),
    _other_text_coco: ("train.json", "the right content, but not the text"),
    _cut_coco: ("train.json", "cut short"),
    _deep_coco: ("train.json", "nested more than 64 deep"),
    _moved_truth: ("truth.csv", "not as its seed puts them"),
    _short_truth: ("truth.csv", "by its seed"),
    _no_number: ("truth.csv", "line 2: not all of its values are numbers"),
    _no_table: ("images.csv", "no such file"),
}


@pytest.mark.parametrize("damage", DAMAGES, ids=lambda damage: damage.__name__.strip("_"))
def test_each_damage_is_found(copy, damage, capsys):
    damage(copy)
    sample = 4 if damage is _short_truth else 1  # the last image has lost a line
    code, _, said = call(capsys, "dataset", "check", copy, "--sample", sample)
    assert code == 1
    file, words = DAMAGES[damage]
    lines = said.splitlines()
    assert any(file in line and words in line for line in lines), said
    assert all(line.startswith("error: ") for line in lines)


def test_check_finds_consistent_labels_that_differ_from_pixels(few, tmp_path):
    """Labels and spec are those of another seed: only the pixels differ."""
    other = make_dataset(spec_of(seed=6, images=4), tmp_path / "other").path
    shutil.rmtree(other / "images")
    shutil.copytree(few / "images", other / "images")
    problems = check_dataset(other).problems
    for words in ("not those of its seed", "which have no label"):
        assert any("images/" in problem and words in problem for problem in problems)


def test_make_and_check_by_the_command_line(tmp_path, capsys):
    folder = tmp_path / "new/set"
    options = ("--out", folder, "--jobs", 1, "--images", 2)
    code, said, complaints = call(capsys, "dataset", "make", "small", *options)
    assert (code, complaints) == (0, "")
    assert "2 images" in said
    assert {path.name for path in folder.iterdir()} >= {"preview.png", "truth.csv", "images.csv", "data.yaml"}
    code, said, _ = call(capsys, "dataset", "check", folder)
    assert code == 0
    assert "good" in said and "RMS error" in said


def test_a_folder_of_another_spec_is_refused(copy, tmp_path, capsys):
    assert_refused(
        call(capsys, "dataset", "make", "small", "--out", copy), str(copy), "another spec", "--out"
    )
    (tmp_path / "full").mkdir()
    (tmp_path / "full/thing").touch()
    assert_refused(
        call(capsys, "dataset", "make", "small", "--out", tmp_path / "full"),
        "is not the folder of a data set",
    )
    assert_refused(call(capsys, "dataset", "make", "small", "--out", tmp_path / "full/thing"), "is a file")
    assert [path.name for path in (tmp_path / "full").iterdir()] == ["thing"]


def test_a_folder_that_is_no_dataset_is_refused(copy, tmp_path, capsys):
    assert_refused(call(capsys, "dataset", "check", tmp_path / "nowhere"), "spec.json")
    (copy / "spec.json").write_text("{")
    assert_refused(call(capsys, "dataset", "check", copy), "spec.json", "damaged")
    assert_refused(call(capsys, "dataset", "check", copy, "--sample", "-1"), "--sample")


BAD = {
    "images = 0": "images",
    "": "images",
    "images = 3\nhello = 1": "hello",
    "images = 3\nseed = -1": "seed",
    "images = 3\nsize_px = [640]": "size_px",
    "images = 3\nvalidation = 1": "validation",
    "images = 3\nmarkers.count = [5, 2]": "[5, 2]; a range with the smaller number first",
    "images = 3\nmarkers.count = [5, 200]": "at most 50, the number of markers",
    "images = 3\nmarkers.count = 2.5": "markers.count: 2.5; a whole number from 0 to 1000",
    "images = 3\nmarkers.ids = [1, 50]": "markers.ids: a repeated or unknown id; 0 to 49",
    "images = 3\nmarkers.dictionary = 'x'": "no dictionary 'x'",
    "images = 3\nmarkers.side_px = [20, 1000]": "fits",
    "images = 3\nmarkers.white = 20": "darker than white",
    "images = 3\ncamera.tilt_deg = 50": "at most 80",
    "images = 3\ncamera.distortion.k1 = -2": "folds the image",
    "images = 3\nsensor.noise = 'much'": "sensor.noise",
    "images = 3\nsensor.jpeg_quality = [0, 90]": "jpeg_quality",
    "images = 3\nground.kinds = []": "neither kinds nor images",
    "images = 3\nground.kinds = ['grass']": "ground.kinds",
    "images = 3\nground.images = ['none.png']": "none.png",
    "images = 3\noccluders.share = 2": "occluders.share",
    "images = ": "malformed TOML",
}


@pytest.mark.parametrize("text", BAD)
def test_bad_specs_are_one_line_each_and_leave_nothing(tmp_path, text, capsys):
    file = tmp_path / "bad.toml"
    file.write_text(text)
    result = call(capsys, "dataset", "make", file, "--out", tmp_path / "out")
    assert_refused(result, "bad.toml" if "none.png" not in text else "none.png", BAD[text])
    assert not (tmp_path / "out").exists()


def test_unknown_specs_and_jobs_are_refused(tmp_path, capsys):
    assert_refused(call(capsys, "dataset", "make", "nothing", "--out", tmp_path / "x"), "small, varied")
    assert_refused(call(capsys, "dataset", "make", tmp_path / "x.toml"), "x.toml", "no such file")
    assert_refused(call(capsys, "dataset", "make", "small", "--jobs", 0), "--jobs")


def test_list_show_and_schema(tmp_path, capsys):
    assert "varied" in call(capsys, "dataset", "list")[1]
    code, text, _ = call(capsys, "dataset", "show", "small")
    assert code == 0 and 'description = "' in text
    schema = json.loads(call(capsys, "dataset", "schema")[1])
    noise = schema["$defs"]["SensorSpec"]["properties"]["noise"]
    assert [form["type"] for form in noise["anyOf"]] == ["number", "array"]
    assert "grey levels" in noise["description"]
