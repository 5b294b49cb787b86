"""Arbitrary file names: verbs accept them, and tables and terminals show them without interpretation."""

import csv
import json
import os
import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest
from command_line import assert_refused, call

from skyherd.cli.console import say_table
from skyherd.inspection import inspector
from skyherd.inspection.output_names import picture_names

NASTY = [
    "=cmd()|'calc'!A0.png",
    "@sum(1).png",
    "\x1b[31mred\x1b[0m.png",
    "[bold red]markup.png",
    "two\nlines.png",
    "gpj\u202egnp.png",
    os.fsdecode(b"\xff\xfe.png"),
    "comma, \"quote\".png",
    "." + "n" * 240 + ".png",
    "ä漢.png",
    "-.png",
]  # fmt: skip


@pytest.fixture
def pictures(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "in").mkdir()
    ok, data = cv2.imencode(".png", np.full((40, 60), 90, np.uint8))
    assert ok
    for name in [*NASTY, "plain.png"]:
        (tmp_path / "in" / name).write_bytes(data.tobytes())
    return tmp_path


def marked(monkeypatch):
    """Give every picture one row in the table, as if a marker were found."""
    rows = inspector.detection_rows

    def one(place, found, metric):
        yield from rows(place, found, metric)
        yield {
            **vars(place), **dict.fromkeys(inspector.DETECTION_COLUMNS[3:], 0), "corners_px": np.zeros((4, 2))
        }  # fmt: skip

    monkeypatch.setattr(inspector, "detection_rows", one)


@pytest.mark.parametrize("kind", ["csv", "jsonl"])
def test_folder_of_unusual_names_has_complete_table(pictures, capsys, monkeypatch, kind):
    """Lines 4 and 9."""
    marked(monkeypatch)
    code, out, err = call(capsys, "detect", "in", "--out", "out", "--format", kind)
    assert code == 0, err
    for stream in (out, err):
        stream.encode("utf-8")
        assert "\x1b" not in stream and "\u202e" not in stream
    assert "[bold red]markup.png" in out
    assert r"\xff\xfe.png" in out
    text = (pictures / "out" / f"detections.{kind}").read_text("utf-8")
    rows = list(csv.DictReader(text.splitlines())) if kind == "csv" else map(json.loads, text.splitlines())
    files = [row["file"] for row in rows]
    assert len(files) == len(NASTY) + 1
    assert {"plain.png", r"two\x0alines.png", r"\xff\xfe.png"} <= set(files)
    if kind == "csv":
        assert not [name for name in files if name.startswith(("=", "@", "+", "-"))]
        assert "'@sum(1).png" in files
    made = [path.name for path in (pictures / "out").glob("*.png")]
    assert len(made) == len(NASTY) + 1
    for name in made:
        name.encode("utf-8")
        assert name.isprintable() and len(name.encode()) < 255


def test_unusual_name_is_read_and_named_in_one_line(pictures, capsys):
    for name in NASTY:
        code, out, err = call(capsys, "detect", f"in/{name}")
        assert code == 0, err
        assert "\x1b" not in out + err and err.count("\n") == 1
        (pictures / "in" / name).write_text("no picture")
        assert_refused(call(capsys, "detect", f"in/{name}", "--out", "again"), "not a picture")


@pytest.mark.parametrize(
    "verb",
    [
        ["scenario", "check"],
        ["run"],
        ["play"],
        ["view"],
        ["topology"],
        ["report"],
        ["export"],
        ["dataset", "check"],
        ["dataset", "make"],
        ["study"],
    ],
    ids=" ".join,
)
def test_every_verb_names_unusual_files_in_one_line(pictures, capsys, verb):
    for name in NASTY:
        code, out, err = call(capsys, *verb, "--", f"in/{name}")
        assert (code, out, err.count("\n")) == (2, "", 1)
        assert not set(err) & {"\x1b", "\u202e"}
        assert len(err) < 500


def test_table_shows_no_markup_and_no_escape(capsys):
    say_table(("file",), [("[red]a\x1b[2J",)])
    assert r"[red]a\x1b[2J" in capsys.readouterr().out


def test_names_that_look_alike_get_separate_pictures():
    files = [Path("a\x01.png"), Path(r"a\x01.png"), Path("a_x01.png"), Path("a.png"), Path("a.jpg")]
    names = picture_names(files)
    assert len(set(names.values())) == len(files)


def test_terminal_without_utf8_shows_escaped_characters(tmp_path):
    code = "from skyherd.cli import main; main()"
    command = [sys.executable, "-c", code, "scenario", "check", "漢.toml"]
    ended = subprocess.run(
        command,
        cwd=tmp_path,
        env={**os.environ, "PYTHONIOENCODING": "latin-1"},
        capture_output=True,
        check=False,
    )
    assert ended.returncode == 2 and ended.stderr.startswith(rb"error: \u6f22.toml: no such file")
