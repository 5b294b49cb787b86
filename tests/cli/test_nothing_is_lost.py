"""No verb replaces or removes a file that it did not make, for any --out and --force."""

import hashlib
import os
from pathlib import Path

import cv2
import numpy as np
import pytest
from command_line import assert_refused, call

from skyherd.bench.photographs.result import csv_text
from skyherd.errors import OutputError
from skyherd.plots import panels

QUICK = ["--perception", "ideal", "--no-video", "--set", "duration_s=0.3"]


@pytest.fixture
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(panels, "PANELS", panels.PANELS[:1])
    return tmp_path


def hashes(folder: Path) -> dict[str, str]:
    """Return the SHA-256 of every file below a folder."""
    files = sorted(path for path in folder.rglob("*") if path.is_file())
    return {str(path.relative_to(folder)): hashlib.sha256(path.read_bytes()).hexdigest() for path in files}


def photograph(path: Path, grey: int = 90) -> None:
    path.parent.mkdir(exist_ok=True)
    cv2.imwrite(str(path), np.full((40, 60), grey, np.uint8))


def assert_untouched(folder: Path, capsys, *arguments) -> None:
    before = hashes(folder)
    assert_refused(call(capsys, *arguments))
    assert hashes(folder) == before


def test_detect_never_replaces_a_photograph(here, capsys):
    """The photograph stays byte by byte."""
    photograph(here / "photos" / "one.png")
    photograph(here / "photos" / "two.png", 30)
    photograph(here / "one.png")
    photograph(here / "q" / "a.jpg")
    photograph(here / "q" / "a.png", 200)
    assert_untouched(here, capsys, "detect", "photos", "--out", "photos", "--force")
    assert_untouched(here, capsys, "detect", "one.png", "--out", ".", "--force")
    assert_untouched(here, capsys, "detect", "one.png", "--out", ".")
    assert_untouched(here, capsys, "detect", "q/a.jpg", "--out", "q", "--force")


def test_detect_never_replaces_its_own_input_picture(here, capsys):
    photograph(here / "a.png")
    assert call(capsys, "detect", "a.png", "--out", "found")[0] == 0
    assert_untouched(here, capsys, "detect", "found/a.png", "--out", "found", "--force")


def test_detect_never_removes_a_foreign_table(here, capsys):
    """A table of the user in a folder of pictures stays."""
    photograph(here / "a.png")
    for name in ("detections.csv", "rejected.jsonl"):
        (here / "mine").mkdir(exist_ok=True)
        (here / "mine" / name).write_text("precious")
    before = hashes(here / "mine")
    assert_refused(call(capsys, "detect", "a.png", "--out", "mine", "--force"), "detections.csv", "not made")
    (here / "mine" / "detections.csv").rename(here / "mine" / "old.csv")
    assert call(capsys, "detect", "a.png", "--out", "mine", "--force")[0] == 0
    after = hashes(here / "mine")
    assert set(before.values()) <= set(after.values())


def test_topology_replaces_only_its_own_file(here, capsys):
    """Neither a file of the user nor another verb's file is replaced."""
    (here / "pic.png").write_bytes(b"a photograph")
    assert_untouched(here, capsys, "topology", "triangle", "--out", "pic.png")
    assert_untouched(here, capsys, "topology", "triangle", "--out", "pic.png", "--force")
    (here / "triangle-topology.png").write_bytes(b"a photograph")
    assert_untouched(here, capsys, "topology", "triangle")
    (here / "triangle-topology.png").unlink()
    assert call(capsys, "topology", "triangle")[0] in (0, 1)
    for out in ([], ["--out", "triangle-topology.png"]):
        assert_untouched(here, capsys, "topology", "triangle", *out)
        assert call(capsys, "topology", "triangle", *out, "--force")[0] in (0, 1)


@pytest.mark.parametrize("name", ["video.mp4", "summary.json", "report.html", "run.mcap"])
def test_run_never_removes_foreign_files(here, capsys, name):
    """Files that no run made stay in the folder."""
    (here / "mine").mkdir()
    (here / "mine" / name).write_text("precious")
    assert_untouched(here, capsys, "run", "triangle", "--out", "mine", "--force", *QUICK)


def test_run_and_report_replace_only_their_own_files(here, capsys):
    assert call(capsys, "run", "triangle", "--out", "out", *QUICK)[0] == 1
    (here / "out" / "notes.txt").write_text("precious")
    assert call(capsys, "run", "triangle", "--out", "out", "--force", *QUICK)[0] == 1
    assert call(capsys, "report", "out")[0] == 0
    (here / "out" / "summary.json").write_text("edited by hand")
    assert_untouched(here, capsys, "report", "out")
    assert_untouched(here, capsys, "run", "triangle", "--out", "out", "--force", *QUICK)
    assert (here / "out" / "notes.txt").read_text() == "precious"


def test_report_never_replaces_a_foreign_file(here, capsys):
    """The recording lies in a folder with files of the user."""
    call(capsys, "run", "triangle", "--out", "out", *QUICK)
    (here / "sent").mkdir()
    (here / "out" / "run.mcap").rename(here / "sent" / "run.mcap")
    (here / "sent" / "report.html").write_text("a letter")
    assert_untouched(here, capsys, "report", "sent")
    (here / "sent" / "report.html").unlink()
    assert call(capsys, "report", "sent")[0] == 0


@pytest.mark.parametrize("kind", ["csv", "coco"])
def test_export_never_replaces_or_removes_foreign_files(here, capsys, kind):
    """Neither files of the user nor the run's own files are replaced."""
    call(capsys, "run", "triangle", "--out", "out", *QUICK)
    arguments = ["export", "out", "--format", kind, "--force", "--out"]
    assert_untouched(here, capsys, *arguments[:-2], "--out", "out")
    main_file = {"csv": "detections.csv", "coco": "annotations.json"}[kind]
    (here / "mine" / "images").mkdir(parents=True)
    (here / "mine" / "images" / "holiday.jpg").write_bytes(b"precious")
    if kind == "coco":
        assert_untouched(here, capsys, *arguments, "mine")
        (here / "mine" / "images").rename(here / "mine" / "pictures")
    (here / "mine" / main_file).write_text("precious")
    assert_untouched(here, capsys, *arguments, "mine")
    (here / "mine" / main_file).unlink()
    kept = hashes(here / "mine")
    for _ in range(2):
        assert call(capsys, *arguments, "mine")[0] == 0
    assert kept.items() <= hashes(here / "mine").items()
    (here / "mine" / main_file).write_text("edited by hand")
    assert_untouched(here, capsys, *arguments, "mine")


def test_markers_never_replaces_a_foreign_pdf(here, capsys):
    arguments = ["markers", "--ids", "0", "--side", "3cm", "--out", "thesis.pdf"]
    (here / "thesis.pdf").write_bytes(b"%PDF years of work")
    assert_untouched(here, capsys, *arguments, "--force")
    (here / "thesis.pdf").unlink()
    assert call(capsys, *arguments)[0] == 0
    assert_untouched(here, capsys, *arguments)
    assert call(capsys, *arguments, "--force")[0] == 0


def test_dataset_make_refuses_foreign_folders(here, capsys):
    (here / "mine").mkdir()
    (here / "mine" / "preview.png").write_bytes(b"mine")
    assert_untouched(here, capsys, "dataset", "make", "small", "--out", "mine")
    (here / "spec.json").write_text("{}")
    assert_untouched(here, capsys, "dataset", "make", "small", "--out", ".")


def test_bench_replaces_only_its_own_files_and_with_force(here, capsys):
    (here / "mine").mkdir()
    (here / "mine" / "bench.json").write_text("precious")
    assert_untouched(here, capsys, "bench", "detectors", "--quick", "--out", "mine")
    assert_untouched(here, capsys, "bench", "detectors", "--quick", "--out", "mine", "--force")


SETS = """
[desk]
files = ["*.png"]
dictionary = "4X4_50"
board = { kind = "aruco", columns = 2, rows = 2 }
"""


@pytest.fixture(params=["photographs", "boards"])
def measure(request, here):
    """Return the arguments of a short measurement on two photographs; further ones can follow."""
    photograph(here / "in" / "a.png")
    photograph(here / "in" / "b.png", 30)
    (here / "in" / "photographs.toml").write_text(SETS)
    return ["bench", request.param, "in", "--detector", "opencv"]


def test_photograph_measurement_replaces_only_its_own_files(here, capsys, measure):
    result = f"{measure[1]}.json"
    taken = hashes(here / "in")
    assert call(capsys, *measure, "--out", "out")[0] == 0
    assert hashes(here / "in") == taken
    assert_untouched(here, capsys, *measure, "--out", "out")
    figures = sorted((here / "out" / "figures").iterdir())
    assert figures
    (here / "out" / "figures" / "mine.png").write_bytes(b"mine")
    assert call(capsys, *measure, "--out", "out", "--force")[0] == 0
    assert (here / "out" / "figures" / "mine.png").read_bytes() == b"mine"
    for changed in (here / "out" / result, figures[0]):
        before = changed.read_bytes()
        changed.write_bytes(b"edited by hand")
        assert_untouched(here, capsys, *measure, "--out", "out", "--force")
        changed.write_bytes(before)
    assert call(capsys, *measure, "--out", "out", "--force")[0] == 0


def test_photograph_measurement_refuses_foreign_files(here, capsys, measure):
    result = f"{measure[1]}.json"
    (here / "mine" / "figures").mkdir(parents=True)
    (here / "mine" / result).write_text("precious")
    assert_untouched(here, capsys, *measure, "--out", "mine")
    assert_untouched(here, capsys, *measure, "--out", "mine", "--force")
    (here / "mine" / result).unlink()
    figure = {"photographs": "recall.svg", "boards": "boards.png"}[measure[1]]
    (here / "mine" / "figures" / figure).write_text("precious")
    assert_untouched(here, capsys, *measure, "--out", "mine", "--force")
    (here / "mine" / "figures" / figure).unlink()
    (here / "mine" / "figures").rmdir()
    (here / "mine" / "figures").write_text("a file where the folder would be")
    assert_untouched(here, capsys, *measure, "--out", "mine", "--force")


def test_photograph_measurement_never_replaces_its_input(here, capsys, measure):
    """The folder keeps all files, and measured pictures that skyherd made are not replaced."""
    taken = hashes(here / "in")
    assert_untouched(here, capsys, *measure, "--out", "in")
    assert call(capsys, *measure, "--out", "in", "--force")[0] == 0
    assert taken.items() <= hashes(here / "in").items()
    sets = SETS.replace("*.png", "figures/*.png")
    (here / "sets.toml").write_text(sets)
    assert list((here / "in" / "figures").glob("*.png"))
    assert_untouched(here, capsys, *measure, "--sets", "sets.toml", "--out", "in", "--force")


def test_set_and_photograph_names_can_be_any_text(here, capsys, measure):
    """Figures and tables show the names as text, not as formulas."""
    _, data = cv2.imencode(".png", np.full((40, 60), 90, np.uint8))
    for name in ("=cmd().png", "\x1b[31m.png", "$\\frac$.png", os.fsdecode(b"\xff.png")):
        (here / "in" / name).write_bytes(data.tobytes())
    sets = SETS.replace("[desk]", '["$\\\\frac$"]')
    (here / "in" / "photographs.toml").write_text(sets)
    code, _, err = call(capsys, *measure, "--out", "out")
    assert (code, err) == (0, "")
    rows = [{"set": "=a", "image": "@b.png", "id": 3, "u_px": -1.5, "found_by": "\x1b[2J"}]
    assert csv_text(rows, tuple(rows[0])).splitlines()[1] == r"'=a,'@b.png,3,-1.5,\x1b[2J"


@pytest.mark.parametrize("verb", [["markers", "--ids", "0", "--side", "3cm"], ["topology", "triangle"]])
def test_impossible_file_name_leaves_record_unchanged(here, capsys, verb):
    kind = {"markers": ".pdf", "topology": ".png"}[verb[0]]
    assert call(capsys, *verb, "--out", f"good{kind}")[0] in (0, 1)
    assert_untouched(here, capsys, *verb, "--out", "n" * 300 + kind)


@pytest.mark.parametrize("when", ["reading", "drawing"])
def test_failed_photograph_measurement_leaves_nothing(here, capsys, measure, monkeypatch, when):
    if when == "reading":
        (here / "in" / "b.png").write_text("no picture")
    else:

        def full(*_):
            raise OutputError("no space left on device")

        page = "skyherd.bench.measurement_page.render_page"
        monkeypatch.setattr(page, lambda *_, **__: full())
    before = sorted(here.rglob("*"))
    assert_refused(call(capsys, *measure, "--out", "new/out"))
    assert sorted(here.rglob("*")) == before


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ('files = [""]', "such as *.jpg"),
        ('files = ["/etc/*"]', "such as *.jpg"),
        ('files = ["**x"]', "such as *.jpg"),
        ('board = { kind = "charuco", columns = 1, rows = 9 }', "at least 2 x 2"),
        ('board = { kind = "aprilgrid", columns = 1000, rows = 1000 }', "1000000 markers"),
        ('board = { kind = "aruco", columns = 2, rows = 2, first_id = 47 }', "ids up to 50"),
    ],
)
def test_invalid_photograph_set_is_one_line(here, capsys, measure, wrong, said):
    key = wrong.partition(" ")[0]
    lines = [wrong if line.startswith(f"{key} ") else line for line in SETS.splitlines()]
    (here / "in" / "photographs.toml").write_text("\n".join(lines))
    assert_refused(call(capsys, *measure, "--out", "out"), "photographs.toml: [desk]", said)


def test_study_never_replaces_a_foreign_table(here, capsys, write_study, without_cluster):
    study = write_study()
    (here / "out").mkdir()
    (here / "out" / "study.json").write_text("{}")
    (here / "out" / "table.md").write_text("precious")
    assert_untouched(here, capsys, "study", study, "--out", "out")
    assert call(capsys, "study", study, "--out", "new")[0] == 0
    assert call(capsys, "study", study, "--out", "new")[0] == 0
    (here / "new" / "table.md").write_text("edited by hand")
    assert_untouched(here, capsys, "study", study, "--out", "new")


@pytest.mark.parametrize(
    "arguments",
    [
        ["run", "triangle", "--out", "new/out", "--seed", str(2**70)],
        ["run", "triangle", "--out", "new/out", "--set", "units.0.camera.mirrored=true"],
        ["play", "triangle", "--out", "new/out"],
        ["view", "new", "--html", "out.html"],
        ["detect", "text.png", "--out", "new/out"],
        ["detect", "pipe", "--out", "new/out"],
        ["topology", "triangle", "--out", "new/out.png"],
        ["markers", "--ids", "0", "--side", "9m", "--out", "new.pdf"],
        ["dataset", "make", "small", "--out", "new/out", "--seed", "-1"],
        ["bench", "detectors", "--out", "new/out", "--detectors", "nonsense"],
        ["bench", "detectors", "--out", "new/out", "--seed", "-1"],
        ["study", "noise", "--quick", "--out", "new/out", "--scheduler", "tls://127.0.0.1:1"],
        ["study", "noise", "--quick", "--out", "new/out", "--scheduler", "tcp://127.0.0.1:1"],
    ],
    ids=lambda arguments: " ".join(arguments)[:50],
)  # fmt: skip
def test_failed_verb_leaves_no_new_folder(here, capsys, arguments):
    (here / "text.png").write_text("no picture")
    os.mkfifo(here / "pipe")
    before = sorted(here.rglob("*"))
    assert_refused(call(capsys, *arguments))
    assert sorted(here.rglob("*")) == before
