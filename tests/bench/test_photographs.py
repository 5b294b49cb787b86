"""`skyherd bench photographs`: confirmation, counts, outputs, and rejected input."""

import csv
import json
import shutil

import cv2
import numpy as np
import pytest
from command_line import assert_refused, call
from PIL import Image

from skyherd.bench.image_sets import load_image_sets
from skyherd.bench.photographs.confirmation import family, judge
from skyherd.bench.photographs.contact_sheet import TILE_PX, cut_tile, draw_sheet
from skyherd.bench.photographs.measurement import measure_photographs
from skyherd.bench.photographs.sightings import Sightings, make_readers
from skyherd.errors import InputError
from skyherd.markers.dictionary import marker_cells

SQUARE = np.array([[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5]])

SETS = """
[desk]
files = ["*.png"]
dictionary = "4X4_50"
ids_repeat = true

[elsewhere]
files = ["*.jpg"]
dictionary = "4X4_50"
"""

STRANGER = '''
import numpy as np

from skyherd.vision import create_detector, detections_of_corners


class Liar:
    """Calls id 1 id 9, and sees id 7 in the upper left corner of every image."""

    def __init__(self, dictionary):
        self._opencv = create_detector("opencv", dictionary=dictionary)

    def detect(self, image, *, time_s=0.0, unit_id=0):
        ids, corners = self._opencv.find_all(image)
        ids = np.append(np.where(ids == 1, 9, ids), 7)
        corners = np.concatenate([corners, np.array([[[2, 2], [12, 2], [12, 12], [2, 12]]], float)])
        ids, first = np.unique(ids, return_index=True)
        n = ids.size
        return detections_of_corners(
            image, ids, corners[first], headings_rad=np.zeros(n), sides_px=np.full(n, 30.0),
            covariances=np.zeros((n, 3, 3)), time_s=time_s, unit_id=unit_id,
        )
'''


def seen(*markers):
    """Return sightings of (id, centre, side)."""
    ids = np.array([marker[0] for marker in markers], dtype=np.int64)
    corners = np.array([np.add(center, side * SQUARE) for _, center, side in markers]).reshape(-1, 4, 2)
    return Sightings(ids, corners, np.zeros((ids.size, 3, 3)), np.zeros(ids.size, dtype=np.int64))


def places(found):
    return sorted((place.marker_id, *np.round(place.center_px).astype(int).tolist()) for place in found)


def draw(path, markers, size=(260, 320), ground=200):
    """Draw a picture of markers (id, left, top, side), slightly blurred."""
    image = np.full(size, ground, np.uint8)
    for marker_id, left, top, side in markers:
        cells = marker_cells("4X4_50", marker_id).astype(np.uint8)
        drawn = cv2.resize(cells, (side, side), interpolation=cv2.INTER_NEAREST_EXACT)
        image[top : top + side, left : left + side] = np.where(drawn, ground, 30)
    Image.fromarray(cv2.GaussianBlur(image, (0, 0), 0.6)).save(path)


@pytest.fixture
def folder(tmp_path):
    made = tmp_path / "images"
    made.mkdir()
    draw(made / "a.png", [(1, 30, 40, 48), (2, 150, 60, 60)])
    draw(made / "b.png", [(3, 30, 40, 48), (3, 150, 120, 60)])
    (made / "photographs.toml").write_text(SETS)
    return made


def test_marker_is_confirmed_by_two_families():
    """A distance of 0.3 of a side is another place; detectors of one family count once."""
    ours, refined, other = seen((1, (50, 50), 20)), seen((1, (51, 50), 20)), seen((1, (55.5, 50), 20))
    assert judge({"photometric": ours, "tracking": refined}).confirmed == ()
    assert judge({"opencv": ours, "opencv-subpix": refined}).confirmed == ()
    assert places(judge({"photometric": ours, "opencv": refined}).confirmed) == [(1, 50, 50)]
    assert places(judge({"photometric": ours, "opencv": other}).confirmed) == [(1, 53, 50)]
    farther = judge({"photometric": ours, "opencv": seen((1, (56.5, 50), 20))})
    assert farther.confirmed == () and places(farther.alone) == [(1, 50, 50), (1, 56, 50)]
    assert judge({"photometric": ours, "opencv": seen((2, (50, 50), 20))}).confirmed == ()
    assert judge({}) == judge({"opencv": seen()})
    names = ("tracking", "opencv-contour", "apriltag3", "locus-tag", "mine:make")
    assert [family(name) for name in names] == ["ours", "opencv", "apriltag3", "locus-tag", "mine:make"]


def test_wrong_id_needs_confirmed_place():
    found = {
        "opencv": seen((1, (50, 50), 20), (4, (90, 90), 20)),
        "locus-tag": seen((1, (50, 50), 20)),
        "apriltag3": seen((6, (52, 50), 20)),
    }
    judged = judge(found)
    assert places(judged.confirmed) == [(1, 50, 50)]
    assert places(judged.mistaken) == [(6, 52, 50)] and judged.mistaken[0].found_by == ("apriltag3",)
    assert places(judged.alone) == [(4, 90, 90)]


def test_unique_id_counts_at_place_with_more_families():
    twice = {
        "opencv": seen((1, (50, 50), 20), (1, (150, 50), 20)),
        "locus-tag": seen((1, (50, 50), 20), (1, (150, 50), 20)),
        "apriltag3": seen((1, (150, 50), 20)),
    }
    assert places(judge(twice).confirmed) == [(1, 150, 50)]
    assert places(judge(twice).alone) == [(1, 50, 50)]
    assert places(judge(twice, ids_repeat=True).confirmed) == [(1, 50, 50), (1, 150, 50)]


def test_counts_match_drawn_markers(folder, tmp_path, monkeypatch):
    """Four markers, all found by OpenCV; a faulty detector misreads one and reports an absent one.

    Each other detector reports at most one of the two markers of id 3, so that one of them is unconfirmed.
    """
    (tmp_path / "liars.py").write_text(STRANGER)
    monkeypatch.syspath_prepend(tmp_path)
    sets = load_image_sets(folder)
    assert [(one.name, len(one.files)) for one in sets] == [("desk", 2)]
    measured = measure_photographs(sets, ["opencv", "tracking", "liars:Liar"], ["opencv", "tracking"])
    rows = {row["detector"]: row for row in measured.rows}
    assert {row["confirmed"] for row in rows.values()} == {3}
    opencv, liar, tracking = rows["opencv"], rows["liars:Liar"], rows["tracking"]
    assert (opencv["found"], opencv["recall"], opencv["wrong_ids"], opencv["alone"]) == (3, 1.0, 0, 1)
    assert opencv["times_reference"] == 1.0 and opencv["images"] == 2
    assert (liar["found"], liar["wrong_ids"], liar["alone"]) == (2, 1, 2)
    assert tracking["found"] == 2, "it leaves out ids that repeat"
    missed = {(row["image"], row["id"], row["missed_by"]) for row in measured.missed}
    assert missed == {("a.png", 1, "liars:Liar"), ("b.png", 3, "tracking")}
    (one,) = (row for row in measured.missed if row["id"] == 1)
    assert one["u_px"] == pytest.approx(53.5, abs=0.5) and one["side_px"] == pytest.approx(48, abs=1)
    assert one["found_by"] == "opencv tracking"
    assert {(row["id"], row["kind"]) for row in measured.unconfirmed} == {
        (9, "wrong id"),
        (7, "alone"),
        (3, "alone"),
    }
    assert len(measured.missed_tiles["liars:Liar"]) == len(measured.missed_tiles["tracking"]) == 1


def test_command_writes_all_outputs(folder, tmp_path, capsys):
    out = tmp_path / "out"
    code, said, err = call(
        capsys, "bench", "photographs", folder, "--detector", "opencv,tracking,photometric", "--out", out
    )
    assert code == 0, err
    assert "desk" in said and "100.0 %" in said and str(out / "photographs.html") in said
    assert "opencv-subpix" not in said
    result = json.loads((out / "photographs.json").read_text())
    assert {row["detector"] for row in result["rows"]} == {"opencv", "tracking", "photometric"}
    with (out / "missed.csv").open() as lines:
        rows = list(csv.DictReader(lines))
    assert {(row["image"], row["id"]) for row in rows} == {("b.png", "3")}
    page = (out / "photographs.html").read_text()
    assert "Confirmed, but missed by tracking" in page and page.count("data:image/png") >= 2
    assert (out / "figures" / "missed_tracking.png").exists()


@pytest.mark.parametrize(
    ("sets", "words"),
    [
        ("[desk]\nfiles = ['*.png']\ndictionary = '4X4_51'", ["[desk]", "4X4_51"]),
        ("[desk]\nfiles = ['*.png']", ["[desk]: dictionary", "missing"]),
        ("[desk]\nfiles = []\ndictionary = '4X4_50'", ["files"]),
        ("[desk]\nfiles = ['*.png']\ndictionary = '4X4_50'\nborder = 2", ["border", "unknown key"]),
        ("desk = 3", ["is not a table"]),
        ("[desk", ["malformed TOML"]),
        ("[desk]\nfiles = ['*.bmp']\ndictionary = '4X4_50'", ["no image of the sets"]),
        (None, ["photographs.toml"]),
    ],
)
def test_wrong_sets_file_is_rejected(folder, capsys, sets, words):
    path = folder / "photographs.toml"
    path.unlink() if sets is None else path.write_text(sets)
    assert_refused(call(capsys, "bench", "photographs", folder, "--out", folder / "out"), *words)


def test_sets_file_and_selection_are_options(folder, tmp_path, capsys):
    elsewhere = shutil.move(folder / "photographs.toml", tmp_path / "mine.toml")
    assert [one.name for one in load_image_sets(folder, tmp_path / "mine.toml", only=("desk",))] == ["desk"]
    refused = call(capsys, "bench", "photographs", folder, "--sets", elsewhere, "--only", "attic")
    assert_refused(refused, "attic", "one of desk, elsewhere")
    assert_refused(call(capsys, "bench", "photographs", tmp_path / "nowhere"), "no such folder")


def test_detector_without_marker_options_reads_no_set():
    readers, refused = make_readers(["opencv", "apriltag3"], "4X4_50", {})
    assert list(readers) == ["opencv"] and "does not know 4X4_50" in refused["apriltag3"]
    readers, refused = make_readers(["apriltag3", "locus-tag"], "APRILTAG_36h11", {"shape": "round"})
    assert readers == {} and refused["locus-tag"] == "does not support shape"


def test_video_images_are_every_nth_frame(tmp_path):
    writer = cv2.VideoWriter(str(tmp_path / "v.avi"), cv2.VideoWriter_fourcc(*"MJPG"), 10, (64, 48))
    for level in range(7):
        writer.write(np.full((48, 64, 3), 30 * level, np.uint8))
    writer.release()
    (tmp_path / "photographs.toml").write_text("[v]\nfiles = ['*.avi']\ndictionary = '4X4_50'\nevery = 3")
    (one,) = load_image_sets(tmp_path)
    images = dict(one.images())
    assert list(images) == ["v.avi#0", "v.avi#3", "v.avi#6"]
    assert [round(image.mean() / 30) for image in images.values()] == [0, 3, 6]


def test_tile_centres_place_at_image_edge():
    """A bright square in the corner of a dark image: in the tile's centre, with grey beyond the image."""
    image = np.zeros((60, 80), np.uint8)
    image[0:11, 0:11] = 255
    judged = judge({"opencv": seen((1, (5, 5), 11))})
    tile = cut_tile(image, judged.alone[0], "a_long_name_of_a_photograph.png")
    assert tile.picture.shape == (TILE_PX, TILE_PX, 3)
    assert tile.picture[TILE_PX // 2, TILE_PX // 2].tolist() == [255] * 3
    assert tile.picture[3, 3].tolist() == [128] * 3 and tile.picture[-4, -4].tolist() == [0] * 3
    sheet = draw_sheet([tile] * 100)
    assert sheet.shape[1] > 8 * TILE_PX and sheet.shape[0] > 8 * TILE_PX
    assert draw_sheet([tile]).shape[1] < 2 * TILE_PX


def test_unreadable_set_is_reported(folder, capsys, tmp_path):
    (folder / "photographs.toml").write_text("[desk]\nfiles = ['*.png']\ndictionary = '5X5_50'\n")
    arguments = ("--detector", "apriltag3", "--out", tmp_path / "out")
    code, _, err = call(capsys, "bench", "photographs", folder, *arguments)
    assert code == 0 and "no detector can read desk" in err


def test_unreadable_image_ends_with_one_line(folder, capsys, tmp_path):
    (folder / "c.png").write_bytes(b"no picture")
    refused = call(capsys, "bench", "photographs", folder, "--detector", "opencv", "--out", tmp_path / "out")
    assert_refused(refused, "c.png", "not a picture")


def test_set_model_rejects_invalid_values(tmp_path):
    for line in ("border_bits = 0", "every = 0", "inverted = 'maybe'"):
        (tmp_path / "photographs.toml").write_text(f"[v]\nfiles = ['*']\ndictionary = '4X4_50'\n{line}\n")
        with pytest.raises(InputError, match=line.split(" ")[0]):
            load_image_sets(tmp_path)
