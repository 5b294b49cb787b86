"""Output folders: a record of own files, and protection of foreign files."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from skyherd.errors import InputError, OutputError
from skyherd.files.atomic import write_text
from skyherd.files.folder_lock import FolderLock
from skyherd.files.folder_record import RECORD
from skyherd.files.output_file import OutputFile
from skyherd.files.output_folder import OutputFolder

NAMES = ["a.txt", "figures/b.txt"]


def make(folder: Path, content: str = "made", *, verb: str = "run", names=NAMES, **options) -> None:
    """Act as a verb: claim names, and write a file for each."""
    with OutputFolder(folder, verb, names, **options):
        for name in names:
            (folder / name).parent.mkdir(exist_ok=True)
            write_text(folder / name, content)


def contents(folder: Path) -> dict[str, bytes]:
    files = (path for path in folder.rglob("*") if path.is_file())
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in files}


def recorded(folder: Path) -> dict[str, dict[str, str]]:
    return json.loads((folder / RECORD).read_text())["files"]


@pytest.mark.smoke
def test_record_names_maker_of_each_file(tmp_path):
    out = tmp_path / "new" / "out"
    make(out)
    assert sorted(recorded(out)) == NAMES
    assert {entry["made_by"] for entry in recorded(out).values()} == {"run"}
    assert "writer" not in json.loads((out / RECORD).read_text())
    (out / "mine.txt").write_text("mine")
    with pytest.raises(InputError, match=r"exists; choose another `folder=`, or write .* `force=True`"):
        make(out, "again")
    make(out, "again", force=True)
    assert (out / "a.txt").read_text() == "again" and (out / "mine.txt").read_text() == "mine"


def test_force_removes_only_own_files(tmp_path):
    make(tmp_path / "out", names=[*NAMES, "old.txt", "gone/c.txt"])
    (tmp_path / "out" / "gone" / "mine.txt").write_text("mine")
    before = contents(tmp_path / "out")
    make(tmp_path / "out", verb="detect", names=["d.txt"], force=True)
    assert {name: before[name] for name in before if name != RECORD}.items() <= contents(
        tmp_path / "out"
    ).items()
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


@pytest.mark.parametrize("options", [{"force": True}, {"resume": True}])
def test_check_rejects_foreign_files_without_entering(tmp_path, options):
    make(tmp_path / "out")
    OutputFolder(tmp_path / "out", "run", NAMES, **options).check()
    (tmp_path / "out" / "a.txt").write_text("edited")
    before = contents(tmp_path / "out")
    with pytest.raises(InputError, match="was changed since"):
        OutputFolder(tmp_path / "out", "run", NAMES, **options).check()
    assert contents(tmp_path / "out") == before


def test_foreign_file_that_appears_before_the_lock_is_rejected(tmp_path, monkeypatch):
    acquire = FolderLock.acquire

    def late(self, folder, wait_s):
        (folder / "a.txt").write_text("mine")
        return acquire(self, folder, wait_s)

    monkeypatch.setattr(FolderLock, "acquire", late)
    with pytest.raises(InputError, match="was not made by skyherd"):
        make(tmp_path, resume=True)
    assert (tmp_path / "a.txt").read_text() == "mine"


def test_file_in_the_way_of_a_folder_is_rejected_at_any_depth(tmp_path):
    (tmp_path / "deep").write_text("mine")
    with pytest.raises(InputError, match=r"deep: is in the way"):
        make(tmp_path, names=["deep/er/x.txt"], resume=True)


def test_folder_that_another_process_makes_meanwhile_is_used(tmp_path, monkeypatch):
    mkdir = Path.mkdir

    def late(folder, *arguments, **options):
        mkdir(folder, *arguments, **options)
        if folder.name == "new":
            raise FileExistsError

    monkeypatch.setattr(Path, "mkdir", late)
    with pytest.raises(KeyError), OutputFolder(tmp_path / "new" / "out", "run", NAMES):
        raise KeyError
    assert (tmp_path / "new").is_dir() and not (tmp_path / "new" / "out").exists(), "the other's folder stays"


@pytest.mark.parametrize(("first", "second"), [("run", "detect"), ("detect", "run")])
def test_file_of_another_verb_is_rejected(tmp_path, first, second):
    make(tmp_path / "out", verb=first)
    with pytest.raises(InputError, match=f"was made by `skyherd {first}`"):
        make(tmp_path / "out", verb=second, force=True)


def test_own_input_is_never_replaced(tmp_path):
    out = tmp_path / "out"
    make(out)
    (tmp_path / "link.txt").symlink_to(out / "a.txt")
    with pytest.raises(InputError, match="is an input"):
        make(out, "again", force=True, inputs=[tmp_path / "link.txt"])
    assert (out / "a.txt").read_text() == "made"


@pytest.mark.parametrize("error", [InputError("a", "b", "c"), KeyboardInterrupt(), OSError(28, "full")])
def test_failure_removes_new_folder(tmp_path, error):
    out = tmp_path / "new" / "deep" / "out"
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
    names = ["old.txt", *NAMES, "never/"]
    with pytest.raises(KeyboardInterrupt), OutputFolder(tmp_path, "run", names, resume=True):
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


@pytest.mark.smoke
def test_second_process_is_rejected_with_name_of_first(tmp_path):
    out = tmp_path / "out"
    said = rf"`skyherd run` writes into it \(process {os.getpid()} on .*, since \d{{4}}-"
    with OutputFolder(out, "run", NAMES):
        with pytest.raises(InputError, match=said):
            make(out, "other", force=True)
        (out / "a.txt").write_text("first")
    assert (out / "a.txt").read_text() == "first"
    make(out, "other", force=True)


def test_folder_taken_by_another_in_between_is_never_removed(tmp_path, monkeypatch):
    """Another process locks the new folder first, and owns it from then on."""
    out = tmp_path / "new" / "out"
    output = OutputFolder(out, "run", NAMES, resume=True)
    monkeypatch.setattr(FolderLock, "acquire", lambda self, folder, wait_s: False)
    with pytest.raises(InputError, match="writes into it"), output:
        pass
    assert out.is_dir()
    monkeypatch.undo()
    with pytest.raises(KeyError), output:
        raise KeyError
    assert out.is_dir() and not list(out.iterdir())


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


def test_options_are_given_by_name(tmp_path):
    with pytest.raises(TypeError):
        OutputFolder(tmp_path / "out", "run", NAMES, True)


def test_force_removes_empty_folders_of_any_depth(tmp_path):
    out = tmp_path / "out"
    with OutputFolder(out, "run", ["deep/er/still/x.txt", "deep/y.txt"]):
        (out / "deep" / "er" / "still").mkdir(parents=True)
        for name in ("deep/er/still/x.txt", "deep/y.txt"):
            write_text(out / name, "made")
    make(out, names=["a.txt"], force=True)
    assert sorted(path.name for path in out.iterdir()) == [RECORD, "a.txt"]


@pytest.mark.parametrize(("length", "is_refused"), [(254, False), (255, False), (256, True), (300, True)])
def test_name_of_more_than_255_bytes_is_refused(tmp_path, length, is_refused):
    out = tmp_path / ("ü" * (length // 2) + "x" * (length % 2))
    if not is_refused:
        make(out)
        assert (out / "a.txt").exists()
        return
    with pytest.raises(InputError, match="no file can have this name"):
        make(out)
    with pytest.raises(InputError, match="no file can have this name"):
        make(out / "below")


@pytest.mark.parametrize("name", ["missing", "a\0b"])
def test_input_that_is_no_file_protects_nothing(tmp_path, name):
    out = tmp_path / "out"
    make(out)
    make(out, "again", force=True, inputs=[tmp_path / name])
    assert (out / "a.txt").read_text() == "again"


def test_unclaimed_input_among_former_files_stays(tmp_path):
    out = tmp_path / "out"
    make(out, names=["a.txt", "old.txt", "older.txt"])
    make(out, "again", names=["a.txt"], force=True, inputs=[out / "old.txt"])
    assert (out / "old.txt").read_text() == "made" and sorted(recorded(out)) == ["a.txt", "old.txt"]
    assert not (out / "older.txt").exists()


@pytest.mark.parametrize("kept", [False, True])
@pytest.mark.parametrize("fails", [False, True])
def test_empty_new_folder_is_removed_only_after_failure(tmp_path, kept, fails):
    out = tmp_path / "new" / "out"
    try:
        with OutputFolder(out, "run", NAMES) as output:
            if kept:
                output.keep()
            if fails:
                raise KeyError
    except KeyError:
        assert fails
    assert out.exists() == (kept or not fails)
    assert not (out / RECORD).exists()


def test_failure_removes_its_folders_of_any_depth(tmp_path):
    make(tmp_path, names=["mine.txt"], resume=True)
    before = sorted(tmp_path.rglob("*"))
    with pytest.raises(KeyError), OutputFolder(tmp_path, "run", ["deep/er/still/x.txt"], resume=True):
        (tmp_path / "deep" / "er" / "still").mkdir(parents=True)
        (tmp_path / "deep" / "er" / "still" / "x.txt").write_text("half")
        raise KeyError
    assert sorted(tmp_path.rglob("*")) == before


def test_part_that_vanishes_meanwhile_is_no_error(tmp_path, monkeypatch):
    iterdir = Path.iterdir
    monkeypatch.setattr(Path, "iterdir", lambda self: iter([*iterdir(self), self / PART]))
    make(tmp_path / "out")
    monkeypatch.undo()
    assert sorted(contents(tmp_path / "out")) == [RECORD, *NAMES]


def test_discard_takes_keep_back(tmp_path):
    out = tmp_path / "out"
    with pytest.raises(KeyError), OutputFolder(out, "run", NAMES) as output:
        (out / "a.txt").write_text("half")
        output.keep()
        output.discard()
        raise KeyError
    assert not out.exists()


def test_record_that_the_body_removed_is_no_error(tmp_path):
    with OutputFolder(tmp_path / "out", "run", NAMES):
        (tmp_path / "out" / RECORD).unlink()
    assert not list((tmp_path / "out").iterdir())


@pytest.mark.parametrize(
    ("options", "advice"),
    [
        ({}, "move it away, or choose another `folder=`"),
        ({"elsewhere": None}, "move it away"),
        ({"elsewhere": "go"}, "move it away, or go"),
    ],
)
def test_refusal_has_the_advice_of_the_verb(tmp_path, options, advice):
    (tmp_path / "a.txt").write_text("mine")
    with pytest.raises(InputError) as refused:
        make(tmp_path, resume=True, **options)
    assert refused.value.allowed == advice


PART = ".skyherd-0123456789abcdef.part"


def test_parts_are_removed_wherever_the_verb_writes(tmp_path):
    """Partial files are removed at start and end, only beside claimed files and below claimed folders."""
    out = tmp_path / "out"
    names = ["a.txt", "figures/b.txt", "parts/"]
    folders = [out, out / "figures", out / "parts", out / "parts" / "deep" / "er"]
    (out / "other").mkdir(parents=True)
    make(out, names=["a.txt"], resume=True)

    def put_parts():
        for folder in folders:
            folder.mkdir(parents=True, exist_ok=True)
            (folder / PART).write_text("half")
        (out / "other" / PART).write_text("of another")
        (out / "parts" / "whole.txt").write_text("whole")

    with OutputFolder(out, "run", names, resume=True):
        put_parts()
    assert [path.parent for path in out.rglob(PART)] == [out / "other"]
    put_parts()
    with OutputFolder(out, "run", names, resume=True):
        assert [path.parent for path in out.rglob(PART)] == [out / "other"]
    assert (out / "parts" / "whole.txt").exists()


@pytest.mark.parametrize("missing", [os.W_OK, os.X_OK, 0])
def test_folder_without_the_right_to_write_is_refused(tmp_path, monkeypatch, missing):
    """Write and search permissions are required. The test replaces `os.access`, since root has all."""
    monkeypatch.setattr(os, "access", lambda path, mode: not mode & missing)
    if not missing:
        make(tmp_path / "out")
        return
    with pytest.raises(InputError, match="Permission denied; make the folder writable") as refused:
        make(tmp_path / "new" / "out")
    assert refused.value.what == "Permission denied"
    assert not (tmp_path / "new").exists()


def test_disk_failure_at_end_is_reported_and_releases_lock(tmp_path, monkeypatch):
    def full(*_, **__):
        raise OSError(28, "No space left on device")

    with pytest.raises(OSError, match="No space"), OutputFolder(tmp_path / "out", "run", NAMES):
        (tmp_path / "out" / "a.txt").write_text("made")
        monkeypatch.setattr("skyherd.files.output_folder.write_record", full)
    monkeypatch.undo()
    # An error of the body has priority over that of the disk.
    with pytest.raises(KeyError), OutputFolder(tmp_path / "out", "run", NAMES, resume=True) as output:
        output.keep()
        monkeypatch.setattr("skyherd.files.output_folder.write_record", full)
        raise KeyError
    monkeypatch.undo()
    make(tmp_path / "out", force=True)


def test_record_that_cannot_be_written_leaves_no_new_folder(tmp_path, monkeypatch):
    def full(*_, **__):
        raise OutputError("no space left")

    monkeypatch.setattr("skyherd.files.output_folder.write_record", full)
    for _ in range(2):
        with pytest.raises(OutputError, match="no space left"):
            make(tmp_path / "new" / "out")
        assert not list(tmp_path.iterdir())
    monkeypatch.undo()
    make(tmp_path / "new" / "out")


def test_wait_for_the_other_process_ends_at_the_timeout(tmp_path, monkeypatch):
    waits = []
    acquire = FolderLock.acquire
    monkeypatch.setattr(
        FolderLock,
        "acquire",
        lambda self, folder, wait_s: (waits.append(wait_s), acquire(self, folder, 0.0))[1],
    )
    make(tmp_path / "a")
    make(tmp_path / "b", wait_s=7.5)
    assert waits == [0.0, 7.5]


def test_claimed_folder_belongs_to_the_verb_entirely(tmp_path):
    out = tmp_path / "out"
    with OutputFolder(out, "run", ["parts/"]):
        (out / "parts").mkdir()
        (out / "parts" / "x").write_text("x")
    assert recorded(out) == {"parts/": {"made_by": "run"}}
    with OutputFolder(out, "run", ["parts/"], resume=True):
        pass
    (out / "parts" / "x").unlink()
    (out / "parts").rmdir()
    (out / "parts").write_text("a file by that name")
    with pytest.raises(InputError, match="was not made by skyherd"):
        make(out, names=["parts/"], resume=True)
    (out / "parts").unlink()
    (tmp_path / "elsewhere").mkdir()
    (out / "parts").symlink_to(tmp_path / "elsewhere")
    with pytest.raises(InputError, match="was not made by skyherd"):
        make(out, names=["parts/"], resume=True)


@pytest.mark.parametrize("number", range(8))
def test_any_other_content_counts_as_changed(tmp_path, number):
    """The contents have digests above and below the recorded one."""
    make(tmp_path / "out")
    (tmp_path / "out" / "a.txt").write_text(f"edited {number}")
    with pytest.raises(InputError, match="was changed since skyherd made it"):
        make(tmp_path / "out", "again", force=True)


def test_changed_files_stay_and_belong_to_the_user(tmp_path):
    """A former file that was changed is neither removed nor kept in the record."""
    out = tmp_path / "out"
    make(out, names=["a.txt", "old.txt", "older.txt"])
    (out / "old.txt").write_text("edited")
    make(out, "again", names=["a.txt"], force=True)
    assert (out / "old.txt").read_text() == "edited" and not (out / "older.txt").exists()
    assert list(recorded(out)) == ["a.txt"]


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


@pytest.mark.parametrize("name", ["../mine.txt", "a/../../mine.txt", ""])
def test_record_that_leads_out_of_the_folder_is_refused(tmp_path, name) -> None:
    """A crafted record must not let `--force` remove a file of the user elsewhere."""
    folder, mine = tmp_path / "out", tmp_path / "mine.txt"
    folder.mkdir()
    mine.write_text("mine")
    record = {"about": "", "skyherd": "0", "files": {name: {"made_by": "run"}}}
    (folder / ".skyherd.json").write_text(json.dumps(record))
    with pytest.raises(InputError, match="names '"), OutputFolder(folder, "run", ["a.txt"], force=True):
        pass
    assert mine.read_text() == "mine"
