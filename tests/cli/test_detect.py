"""`skyherd detect`, in process: what it leaves, says and refuses."""

import csv
import json
from collections import Counter
from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
from PIL import Image
from video_tags import tag_display

from skyherd.cli import main
from skyherd.cli.detect import _say_rejections
from skyherd.files.video_reader import open_clip, read_clip
from skyherd.files.video_writer import VideoSink, count_frames, read_frames
from skyherd.inspection import inspector
from skyherd.inspection.table import AGAINST
from skyherd.markers.dictionary import marker_cells
from skyherd.vision import Reason

IDS = [4, 11, 30]


def sheet(ids=IDS, *, dictionary="4X4_50", shift_px=0, background=140) -> np.ndarray:
    """Return markers of 48 px, heading up, 100 px apart, centres at (59.5 + 100 k + shift, 59.5)."""
    image = np.full((120, 120 + 100 * (len(ids) - 1) + 20), background, np.uint8)
    for k, marker_id in enumerate(ids):
        cells = np.pad(marker_cells(dictionary, marker_id), 1, constant_values=True)
        card = np.kron(np.where(cells, 230, 30), np.ones((8, 8))).astype(np.uint8)
        half, u = len(card) // 2, 60 + 100 * k + shift_px
        image[60 - half : 60 + half, u - half : u + half] = card
    return image


def call(capsys, *arguments) -> tuple[int, str, str]:
    with pytest.raises(SystemExit) as left:
        main(["detect", *map(str, arguments)])
    said = capsys.readouterr()
    return left.value.code, said.out, said.err


@pytest.fixture
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_unread_part_of_a_file_is_one_warning(here, capsys) -> None:
    Image.fromarray(sheet()).save("a.tif", save_all=True, append_images=[Image.fromarray(sheet([1, 2, 3]))])
    code, out, err = call(capsys, "a.tif")
    assert (code, err) == (0, "warning: a.tif: 2 pages; the first is read\n") and "4, 11, 30" in out


@pytest.mark.smoke
def test_detect_writes_table_and_annotated_picture(here, capsys) -> None:
    Image.fromarray(sheet()).save("a.png")
    code, out, err = call(capsys, "a.png")
    assert (code, err) == (0, "") and "4, 11, 30" in out
    with open("detections/a/detections.csv", newline="") as file:
        rows = list(csv.DictReader(file))
    assert [int(row["id"]) for row in rows] == IDS
    for k, row in enumerate(rows):
        assert float(row["u_px"]) == pytest.approx(59.5 + 100 * k, abs=0.05)
        assert float(row["heading_deg"]) == pytest.approx(-90, abs=0.1)
        assert float(row["side_px"]) == pytest.approx(48, abs=0.1)
        assert float(row["corner0_v_px"]) == pytest.approx(35.5, abs=0.2)
        assert 0 < float(row["std_u_px"]) < 0.1
        assert (row["file"], row["frame"], row["time_s"]) == ("a.png", "", "")
    with Image.open("detections/a/a.png") as picture:
        assert picture.mode == "RGB" and max(picture.size) >= 640
    hidden = [path.name for path in here.rglob("*") if path.name.startswith(".")]
    assert hidden == [".skyherd.json"]


def test_json_lines_have_corners_and_covariance(here, capsys) -> None:
    Image.fromarray(sheet()).save("a.png")
    assert call(capsys, "a.png", "--format", "jsonl", "--out", "x", "--explain")[0] == 0
    rows = [json.loads(line) for line in (here / "x" / "detections.jsonl").read_text().splitlines()]
    assert [row["id"] for row in rows] == IDS
    assert np.shape(rows[0]["corners_px"]) == (4, 2) and np.shape(rows[0]["covariance"]) == (3, 3)
    assert (here / "x" / "rejected.jsonl").read_text() == ""


def test_folder_is_read_by_name_and_skips_broken_files(here, capsys) -> None:
    (here / "pics").mkdir()
    for name, ids in (("b.png", [1]), ("a.png", [2, 3]), ("a.bmp", [5])):
        Image.fromarray(sheet(ids)).save(here / "pics" / name)
    (here / "pics" / "c.png").write_bytes((here / "pics" / "b.png").read_bytes()[:200])
    (here / "pics" / "notes.txt").write_text("no picture")
    code, _, err = call(capsys, "pics", "--out", "x")
    with open("x/detections.csv", newline="") as file:
        assert [(row["file"], row["id"]) for row in csv.DictReader(file)] == [
            ("a.bmp", "5"),
            ("a.png", "2"),
            ("a.png", "3"),
            ("b.png", "1"),
        ]
    errors = [line for line in err.splitlines() if line.startswith("error")]
    assert code == 2 and len(errors) == 1 and "pics/c.png" in errors[0]
    assert sorted(path.name for path in (here / "x").glob("*.png")) == ["a.bmp.png", "a.png.png", "b.png"]


def test_video_is_annotated_frame_by_frame(here, capsys) -> None:
    frames = [sheet(shift_px=2 * k) for k in range(8)]
    with VideoSink("v.mp4", (frames[0].shape[1], frames[0].shape[0]), 8) as sink:
        for frame in frames:
            sink.write(np.dstack([frame] * 3))
    code, out, _ = call(capsys, "v.mp4", "--explain")
    assert code == 0 and "4, 11, 30" in out
    with open("detections/v/detections.csv", newline="") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 24 and {row["frame"] for row in rows} == {str(k) for k in range(8)}
    for row in (row for row in rows if row["id"] == "4"):
        k = int(row["frame"])
        assert float(row["time_s"]) == pytest.approx(k / 8, abs=1e-3)
        assert float(row["u_px"]) == pytest.approx(59.5 + 2 * k, abs=0.2)  # the codec blurs
    assert count_frames("detections/v/v.mp4") == 8
    assert next(read_frames("detections/v/v.mp4")).shape[1] >= 640


def test_detect_prints_reason_without_detections(here, capsys) -> None:
    Image.fromarray(sheet([40, 60], dictionary="5X5_100")).save("other.png")
    Image.fromarray(sheet()[:, ::-1]).save("mirror.png")
    Image.fromarray(np.full((80, 80), 90, np.uint8)).save("plain.png")
    code, _, err = call(capsys, "other.png")
    assert code == 0 and "no marker found" in err and "--dictionary 5X5_100" in err
    assert "mirrored" in call(capsys, "mirror.png")[2]
    assert call(capsys, "plain.png")[2] == "warning: plain.png: no marker found\n"
    assert call(capsys, "plain.png", "--force", "--require")[0] == 1
    assert call(capsys, "other.png", "--force", "--require", "--dictionary", "5X5_100")[0] == 0


@pytest.mark.parametrize(
    ("options", "hint"),
    [
        ([], "another dictionary, and their ids repeat; try --dictionary APRILTAG_36h11 --repeats"),
        (["--repeats"], "another dictionary; try --dictionary APRILTAG_36h11"),
        (
            ["--dictionary", "auto"],
            "4 markers of APRILTAG_36h11 share their ids and are left out; try --repeats",
        ),
    ],
)
def test_hint_leads_to_markers_that_share_an_id(here, capsys, options, hint) -> None:
    Image.fromarray(sheet([0, 0, 0, 0], dictionary="APRILTAG_36h11")).save("a.png")
    _, _, err = call(capsys, "a.png", *options)
    assert err.startswith("warning: a.png: no marker found: ") and err.endswith(f"{hint}\n")
    tried = [*options, *hint.partition("try ")[2].split()]
    code, out, err = call(capsys, "a.png", "--force", "--require", *tried)
    assert (code, err) == (0, "") and " 4  0" in out


def test_explanation_of_a_repeated_id_names_the_option(here, capsys) -> None:
    Image.fromarray(sheet([4, 4, 11])).save("a.png")
    assert "use each id once, or report all of them with --repeats" in call(capsys, "a.png", "--explain")[1]


def test_many_rejections_of_one_reason_are_counted(capsys) -> None:
    """A board of another dictionary has dozens of them; all are in the table."""
    reasons = [Reason.WRONG_BITS] * 7 + [Reason.BLURRED] + [Reason.NO_BITS] * 2
    rejections = [SimpleNamespace(reason=reason, words="why", center_px=(1, 2)) for reason in reasons]
    result = SimpleNamespace(
        file=Path("a.png"), frames=1, rejections=rejections, reasons=Counter(r.value for r in reasons)
    )
    _say_rejections(result)
    head, *lines, rest = capsys.readouterr().out.splitlines()
    assert head == "a.png: not detected:"
    assert [line.split(".")[0].strip() for line in lines] == ["1", "2", "3", "4", "8"]
    assert rest == "  and 3 x bits wrong, 2 x dark quadrilateral without bits"


def test_rejections_have_number_position_and_remedy(here, capsys) -> None:
    image = sheet()
    small = cv2.resize(image, None, fx=0.12, fy=0.12, interpolation=cv2.INTER_AREA)
    image = np.full((240, 340), 140, np.uint8)
    image[100 : 100 + small.shape[0], 100 : 100 + small.shape[1]] = small
    image[180:220, 250:290] = 30  # and a dark patch that is no marker
    noise = np.random.default_rng(1).normal(0, 4, image.shape)
    image = np.clip(cv2.GaussianBlur(image, (0, 0), 0.6) + noise, 0, 255).astype(np.uint8)
    Image.fromarray(image).save("small.png")
    _, out, _ = call(capsys, "small.png", "--explain")
    assert "1. at (" in out and ", at least 8 (most like id" in out and "print larger" in out
    assert " x dark quadrilateral without bits" in out
    with open("detections/small/rejected.csv", newline="") as file:
        rows = list(csv.DictReader(file))
    assert rows[0]["reason"] == "too few pixels" and float(rows[0]["cell_px"]) < 2
    assert rows[0]["quantity"] == "side in px"
    assert float(rows[0]["value"]) < float(rows[0]["limit"]) == 8.0
    assert float(rows[0]["log_odds"]) <= min(float(rows[0][name]) for name in AGAINST)
    assert rows[-1]["reason"] == "no bits"
    assert {rows[-1][name] for name in ["log_odds", "nearest_id", *AGAINST]} == {""}


def test_rotated_video_is_read_upright_with_its_own_times(here, capsys) -> None:
    """Held upright, it stores frames turned by 90 degrees; the annotated film keeps the uneven times, too."""
    stored = np.repeat(np.rot90(sheet())[..., None], 3, axis=2)
    times = [0.0, 0.1, 0.5]
    with VideoSink("v.mp4", (stored.shape[1], stored.shape[0]), 10, timed=True) as sink:
        for time_s in times:
            sink.write(np.ascontiguousarray(stored), time_s)
    tag_display(here / "v.mp4", (0, 1, -1, 0))
    code, out, _ = call(capsys, "v.mp4")
    assert code == 0 and "4, 11, 30" in out
    with open("detections/v/detections.csv", newline="") as file:
        rows = list(csv.DictReader(file))
    for row in rows:
        k = IDS.index(int(row["id"]))
        assert float(row["u_px"]) == pytest.approx(59.5 + 100 * k, abs=0.2)
        assert float(row["heading_deg"]) == pytest.approx(-90, abs=0.5)
        assert float(row["time_s"]) == pytest.approx(times[int(row["frame"])], abs=1e-4)
    assert {row["frame"] for row in rows} == {"0", "1", "2"}
    film = open_clip(here / "detections/v/v.mp4")
    assert [frame.time_s for frame in read_clip(film)] == pytest.approx(times, abs=1e-4)


def test_interrupted_video_leaves_no_table_and_no_film(here, capsys, monkeypatch) -> None:
    with VideoSink("v.mp4", (160, 120), 8) as sink:
        for _ in range(5):
            sink.write(np.full((120, 160, 3), 90, np.uint8))
    look, calls = inspector.Inspector._look, []

    def interrupted(self, *arguments):
        calls.append(1)
        if len(calls) == 3:
            raise KeyboardInterrupt
        return look(self, *arguments)

    monkeypatch.setattr(inspector.Inspector, "_look", interrupted)
    code, _, err = call(capsys, "v.mp4")
    assert code == 130 and "interrupted" in err
    assert [path.name for path in here.iterdir()] == ["v.mp4"]


def test_folder_of_folders_names_the_one_with_pictures(here, capsys) -> None:
    (here / "all" / "images" / "train").mkdir(parents=True)
    Image.fromarray(sheet()).save(here / "all" / "images" / "train" / "a.png")
    code, _, err = call(capsys, "all")
    assert code == 2 and "train" in err and "the folder that they are in" in err, err


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["none.png"], ["none.png", "no such file"]),
        (["empty.png"], ["empty.png", "empty"]),
        (["text.png"], ["text.png", "not a picture"]),
        (["text.mp4"], ["text.mp4", "video"]),
        (["void"], ["void", "no picture in this folder"]),
        (["a.png", "--dictionary", "9X9"], ["9X9", "4X4_50"]),
        (["a.png", "--detector", "yolo"], ["yolo", "photometric"]),
        (["a.png", "--format", "xml"], ["xml", "jsonl"]),
        (["a.png", "--out", "void"], ["void", "--force"]),
        (["a.png", "--out", "text.png/x"], ["text.png"]),
    ],
)
def test_bad_input_is_one_line_and_leaves_nothing(here, capsys, arguments, words) -> None:
    (here / "void").mkdir()
    (here / "empty.png").write_bytes(b"")
    (here / "text.png").write_text("hello")
    (here / "text.mp4").write_text("hello")
    Image.fromarray(sheet()).save("a.png")
    before = sorted(here.rglob("*"))
    code, _, err = call(capsys, *arguments)
    assert code == 2 and err.count("\n") == 1 and all(word in err for word in words), err
    assert sorted(here.rglob("*")) == before


def test_unreadable_input_leaves_no_output(here, capsys) -> None:
    """A video that opens and has no frame, and a folder of nothing but broken pictures."""
    frame = np.zeros((48, 64, 3), np.uint8)
    writer = cv2.VideoWriter("v.avi", cv2.VideoWriter_fourcc(*"MJPG"), 5, (64, 48))
    writer.write(frame)
    writer.release()
    data = (here / "v.avi").read_bytes()
    (here / "v.avi").write_bytes(data[: data.index(b"movi") + 4])
    (here / "pics").mkdir()
    for name in ("a.png", "b.png"):
        (here / "pics" / name).write_text("no picture")
    before = sorted(here.rglob("*"))
    for target, words in (
        ("v.avi", "cannot be read as a video"),
        ("pics", "none of its 2 files can be read"),
    ):
        code, _, err = call(capsys, target, "--out", "out")
        assert (code, err.count("\n")) == (2, 1) and words in err
        assert sorted(here.rglob("*")) == before


# --- kinds of markers ---


def ids_in(folder):
    with open(folder / "detections.csv", newline="") as file:
        return [int(row["id"]) for row in csv.DictReader(file)]


def test_dictionary_of_each_file_is_found(tmp_path, capsys):
    photos = tmp_path / "photos"
    photos.mkdir()
    for name in ("4X4_50", "APRILTAG_36h11"):
        cv2.imwrite(str(photos / f"{name}.png"), sheet([3, 5, 7], dictionary=name))
    code, said, _ = call(capsys, photos, "--dictionary", "auto", "--out", tmp_path / "out")
    assert code == 0
    for name in ("4X4_50", "APRILTAG_36h11"):
        assert f"{name}.png: its markers are of {name}" in said
    assert ids_in(tmp_path / "out") == [3, 5, 7, 3, 5, 7]


@pytest.mark.parametrize(
    ("image", "options", "ids", "otherwise"),
    [
        (255 - sheet(), ["--inverted"], IDS, []),
        (sheet(dictionary="4X4_50@2"), ["--border-bits", "2"], IDS, []),
        (sheet([4, 4, 6]), ["--repeats"], [4, 4, 6], [6]),
    ],
    ids=["white on black", "a border of two cells", "an id that repeats"],
)
def test_other_marker_kinds_are_found_on_request(tmp_path, capsys, image, options, ids, otherwise):
    cv2.imwrite(str(tmp_path / "it.png"), image)
    assert call(capsys, tmp_path / "it.png", "--out", tmp_path / "told", *options)[0] == 0
    assert ids_in(tmp_path / "told") == ids
    code, _, said = call(capsys, tmp_path / "it.png", "--out", tmp_path / "plain")
    assert code == 0 and (otherwise or "no marker found: its markers are " in said)
    assert otherwise or f"try {' '.join(options)}\n" in said
    assert ids_in(tmp_path / "plain") == otherwise


def test_markers_with_a_wide_border_are_explained(tmp_path, capsys):
    """A white cell of the middle one of three is painted over.

    Taken for markers with a border of one cell, none is found, and the option is named.
    """
    image = sheet(dictionary="4X4_50@2")
    cells = marker_cells("4X4_50@2", IDS[1])
    row, column = np.argwhere(cells)[0]
    v, u = 60 + 8 * (row - len(cells) // 2), 160 + 8 * (column - len(cells) // 2)
    image[v : v + 8, u : u + 8] = 30
    cv2.imwrite(str(tmp_path / "it.png"), image)
    wide = call(capsys, tmp_path / "it.png", "--explain", "--out", tmp_path / "out", "--border-bits", "2")[1]
    assert f"1 of 64 cells differ from the nearest marker, id {IDS[1]}" in wide
    assert "margin" not in wide
    _, narrow, said = call(capsys, tmp_path / "it.png", "--explain", "--out", tmp_path / "plain")
    assert "no white margin" not in narrow and "id 4" not in narrow, "they have no outline of their own"
    assert "drawn with a border of 2 cell(s); try --border-bits 2" in said
