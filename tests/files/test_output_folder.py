"""Output folders: own files are known, and foreign files are never replaced or removed."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from skyherd.errors import InputError
from skyherd.files.atomic import write_text
from skyherd.files.folder_record import RECORD
from skyherd.files.output_file import OutputFile
from skyherd.files.output_folder import OutputFolder

NAMES = ["a.txt", "figures/b.txt"]


def make(folder: Path, content: str = "made", *, verb: str = "run", names=NAMES, **options) -> None:
    """Act as a verb: claim names, and write a file of each."""
    with OutputFolder(folder, verb, names, **options):
        for name in names:
            (folder / name).parent.mkdir(exist_ok=True)
            write_text(folder / name, content)


def contents(folder: Path) -> dict[str, bytes]:
    files = (path for path in folder.rglob("*") if path.is_file())
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in files}


def recorded(folder: Path) -> dict[str, dict[str, str]]:
    return json.loads((folder / RECORD).read_text())["files"]


def test_record_names_maker_of_each_file(tmp_path):
    out = tmp_path / "new" / "out"
    make(out)
    assert sorted(recorded(out)) == NAMES
    assert {entry["made_by"] for entry in recorded(out).values()} == {"run"}
    assert "writer" not in json.loads((out / RECORD).read_text())
    (out / "mine.txt").write_text("mine")
    with pytest.raises(InputError, match=r"exists; another --out, or --force"):
        make(out, "again")
    make(out, "again", force=True)
    assert (out / "a.txt").read_text() == "again" and (out / "mine.txt").read_text() == "mine"


def test_force_removes_only_own_files(tmp_path):
    make(tmp_path / "out", names=[*NAMES, "old.txt", "gone/c.txt"])
    (tmp_path / "out" / "gone" / "mine.txt").write_text("mine")
    make(tmp_path / "out", verb="detect", names=["d.txt"], force=True)
    make(tmp_path / "out", "again", force=True)
    assert sorted(contents(tmp_path / "out")) == [RECORD, "a.txt", "d.txt", "figures/b.txt", "gone/mine.txt"]


def foreign(out: Path) -> None:
    (out / "a.txt").unlink()
    (out / RECORD).unlink()
    (out / "a.txt").write_text("precious")


def changed(out: Path) -> None:
    (out / "a.txt").write_text("edited by hand")


def linked(out: Path) -> None:
    (out / "a.txt").rename(out / "elsewhere.txt")
    (out / "a.txt").symlink_to("elsewhere.txt")


def folder_in_place(out: Path) -> None:
    (out / "a.txt").unlink()
    (out / "a.txt").mkdir()


def file_in_the_way(out: Path) -> None:
    (out / "figures" / "b.txt").unlink()
    (out / "figures").rmdir()
    (out / "figures").write_text("mine")


def record_damaged(out: Path) -> None:
    (out / RECORD).write_text("{")


def record_of_nonsense(out: Path) -> None:
    (out / RECORD).write_text('{"files": {"a.txt": 3}}')


@pytest.mark.parametrize(
    "change", [foreign, changed, linked, folder_in_place, file_in_the_way, record_damaged, record_of_nonsense]
)
@pytest.mark.parametrize("way", [{"force": True}, {"resume": True}], ids=["force", "resume"])
def test_foreign_file_is_rejected_before_any_change(tmp_path, change, way):
    out = tmp_path / "out"
    make(out)
    change(out)
    before = contents(out)
    with pytest.raises(InputError, match=r"move it away|remove it"):
        make(out, "again", **way)
    assert contents(out) == before


def test_file_of_another_verb_is_rejected(tmp_path):
    make(tmp_path / "out")
    with pytest.raises(InputError, match="was made by `skyherd run`"):
        make(tmp_path / "out", verb="detect", force=True)


def test_own_input_is_never_replaced(tmp_path):
    out = tmp_path / "out"
    make(out)
    (tmp_path / "link.txt").symlink_to(out / "a.txt")
    with pytest.raises(InputError, match="is an input"):
        make(out, "again", force=True, inputs=[tmp_path / "link.txt"])
    assert (out / "a.txt").read_text() == "made"


@pytest.mark.parametrize("error", [InputError("a", "b", "c"), KeyboardInterrupt(), OSError(28, "full")])
def test_failure_removes_new_folder(tmp_path, error):
    out = tmp_path / "new" / "out"
    with pytest.raises(type(error)), OutputFolder(out, "run", [*NAMES, "parts/"]):
        (out / "parts" / "deep").mkdir(parents=True)
        (out / "parts" / "deep" / "x").write_text("x")
        (out / "a.txt").write_text("half")
        (out / ".skyherd-0123456789abcdef.part").write_text("half")
        raise error
    assert not list(tmp_path.iterdir())


def test_failure_preserves_existing_folder(tmp_path):
    (tmp_path / "mine.txt").write_text("mine")
    make(tmp_path, names=["old.txt"], resume=True)
    before = contents(tmp_path)
    with pytest.raises(KeyboardInterrupt), OutputFolder(tmp_path, "run", ["old.txt", *NAMES], resume=True):
        (tmp_path / "a.txt").write_text("half")
        raise KeyboardInterrupt
    assert contents(tmp_path) == before


def test_kept_files_stay_after_failure(tmp_path):
    out = tmp_path / "out"
    with pytest.raises(KeyboardInterrupt), OutputFolder(out, "run", NAMES) as output:
        (out / "a.txt").write_text("an hour's work")
        output.keep()
        raise KeyboardInterrupt
    assert list(recorded(out)) == ["a.txt"]
    make(out, "again", force=True)


def test_files_of_killed_process_are_own(tmp_path):
    code = f"""
import os
from pathlib import Path
from skyherd.files.output_folder import OutputFolder
folder = Path({str(tmp_path / "out")!r})
with OutputFolder(folder, "run", {NAMES!r}):
    (folder / "a.txt").write_text("half")
    (folder / ".skyherd-0123456789abcdef.part").write_text("half")
    os.kill(os.getpid(), 9)
"""
    subprocess.run([sys.executable, "-c", code], check=False)
    assert json.loads((tmp_path / "out" / RECORD).read_text())["writer"]["verb"] == "run"
    assert (tmp_path / "out" / "a.txt").exists()
    make(tmp_path / "out", "whole", force=True)
    assert sorted(contents(tmp_path / "out")) == [RECORD, *NAMES]


def test_second_process_is_rejected_with_name_of_first(tmp_path):
    out = tmp_path / "out"
    said = rf"`skyherd run` writes into it \(process {os.getpid()} on .*, since \d{{4}}-"
    with OutputFolder(out, "run", NAMES):
        with pytest.raises(InputError, match=said):
            make(out, "other", force=True)
        (out / "a.txt").write_text("first")
    assert (out / "a.txt").read_text() == "first"
    make(out, "other", force=True)


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("file", "is a file"),
        ("file/below", "Not a directory"),
        ("a\0b", "name"),
        ("\udcff", "UTF-8"),
        ("loop", "file"),
    ],
)
def test_impossible_folder_is_rejected(tmp_path, name, words):
    (tmp_path / "file").write_text("mine")
    (tmp_path / "loop").symlink_to("loop")
    before = sorted(tmp_path.iterdir())
    with pytest.raises(InputError, match=words):
        make(tmp_path / name, force=True)
    assert sorted(tmp_path.iterdir()) == before


def test_single_file_is_replaced_only_if_own_and_forced(tmp_path):
    path = tmp_path / "a.pdf"

    def write(content: str, **options) -> None:
        with OutputFile(path, "markers", **options):
            write_text(path, content)

    write("one")
    with pytest.raises(InputError, match="exists"):
        write("two")
    write("two", force=True)
    assert path.read_text() == "two"
    path.write_text("a thesis")
    with pytest.raises(InputError, match="was changed since skyherd made it"):
        write("three", force=True)
    assert path.read_text() == "a thesis"
    with pytest.raises(InputError, match="no folder"), OutputFile(tmp_path / "no" / "a.pdf", "markers"):
        pass
