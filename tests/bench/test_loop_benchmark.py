"""`benchmarks/loop.py`: arithmetic, unpacked versions, refused input, tables and JSON."""

import json
import subprocess
from contextlib import nullcontext
from importlib import import_module

import pytest

from skyherd.errors import InputError


@pytest.fixture(scope="module")
def loop(load_benchmark):
    """Return the script as a module."""
    return load_benchmark("loop")


@pytest.fixture(scope="module")
def against(loop):
    """Return the module that runs two versions in alternation."""
    return import_module("loop_against")


@pytest.fixture(scope="module")
def unpacked(loop):
    return import_module("versions").unpacked


def test_ratios_are_computed_per_round(against):
    """A slower machine in one round changes the medians, but no ratio."""
    pairs = [
        ({"step": 2.0, "places": "a"}, {"step": 4.0, "places": "a"}),
        ({"step": 6.0, "places": "a"}, {"step": 12.0, "places": "a"}),
        ({"step": 2.2, "places": "a"}, {"step": 4.0, "places": "a"}),
    ]
    (ratio,) = against.compare(pairs)
    assert (ratio.name, ratio.this, ratio.other) == ("step", 2.2, 4.0)
    assert (ratio.ratio, ratio.least, ratio.greatest) == pytest.approx((0.5, 0.5, 0.55))
    assert ratio.cells() == ("step", "2.20", "4.00", "0.50", "0.50 to 0.55")
    assert against.same_places(pairs)
    assert not against.same_places([*pairs, (pairs[0][0], {"step": 4.0, "places": "b"})])


def test_parts_of_a_step_sum_to_the_step(loop):
    calls_s = {"render": [0.1, 0.3], "detect": [0.2, 0.2], "control": [0.05, 0.05], "record": [0.1]}
    row = import_module("loop_parts").account([0.5, 1.5], calls_s, plain_s=0.4)
    assert row["steps_per_s"] == 1.0 and row["frames"] == 2
    assert row["step_ms_median"] == 1000.0
    assert row["share"] == pytest.approx(
        {"render": 0.2, "detect": 0.2, "control": 0.05, "record": 0.05, "rest": 0.5}
    )
    assert row["ratio_to_plain_aruco"] == pytest.approx(2.0)  # twice the time of OpenCV


def test_versions_alternate_in_changing_order(against, monkeypatch, tmp_path):
    called = []

    def measured(version, name, duration_s, *, whole):
        called.append(version)
        return {"step": 1.0 if version is None else 2.0, "number": float(len(called))}

    monkeypatch.setattr(against, "_measure", measured)
    pairs = against.measure_pairs("star", 1.0, tmp_path, 3)
    assert called == [None, tmp_path, tmp_path, None, None, tmp_path]
    assert [(this["step"], other["step"]) for this, other in pairs] == [(1.0, 2.0)] * 3
    assert [this["number"] for this, _ in pairs] == [1.0, 4.0, 5.0]


@pytest.fixture
def repository(tmp_path):
    """Return a repository with a tag `old` of a package skyherd in two folders, and a tag `none` without."""
    folder = tmp_path / "repository"

    def git(*words):
        who = ["-c", "user.name=n", "-c", "user.email=e", "-c", "commit.gpgsign=false"]
        subprocess.run(["git", "-C", folder, *who, *words], check=True, capture_output=True)

    folder.mkdir()
    git("init", "-q")
    (folder / "readme").write_text("nothing else")
    git("add", ".")
    git("commit", "-qm", "none")
    git("tag", "none")
    for place, code in {
        "pyproject.toml": '[tool.setuptools.package-dir]\nskyherd = "src/skyherd"\n"skyherd.loop" = "loop"\n',
        "src/skyherd/__init__.py": "",
        "src/skyherd/datasets.py": "def load_mission(name, settings): return name, settings\n",
        "loop/__init__.py": """
import types
class Places:
    def tobytes(self): return b"here"
def run_steps(mission):
    name, settings = mission
    assert settings == ["duration_s=2.0", "perception=rendered"], settings
    if name != "star": raise KeyError(name)
    for _ in range(4): yield types.SimpleNamespace(positions_m=Places())
""",
    }.items():
        (folder / place).parent.mkdir(parents=True, exist_ok=True)
        (folder / place).write_text(code)
    git("add", ".")
    git("commit", "-qm", "old")
    git("tag", "old")
    (folder / "src" / "skyherd" / "__init__.py").write_text("raise RuntimeError('of the working folder')")
    return folder


def test_other_version_is_unpacked_run_and_removed(against, unpacked, repository):
    """The working folder, which has a third version, is neither used nor changed."""
    before = sorted(path for path in repository.rglob("*") if path.is_file())
    with unpacked("old", repository) as folder:
        row = against._measure(folder, "star", 2.0, whole=False)
        with pytest.raises(InputError, match=r"grid in the other version: does not run: KeyError: 'grid'"):
            against._measure(folder, "grid", 2.0, whole=False)
    assert row["step: clock, ms"] >= 0 and row["start: processor, s"] > 0
    assert len(row["places"]) == 64
    assert not folder.exists()
    assert sorted(path for path in repository.rglob("*") if path.is_file()) == before


@pytest.mark.parametrize(
    ("reference", "said"),
    [
        ("never", "not a valid object name"),
        ("none", "has no package skyherd"),
        ("--help", "begins with a hyphen"),
    ],
)
def test_missing_version_is_refused(unpacked, repository, reference, said):
    with pytest.raises(InputError, match=said), unpacked(reference, repository):
        pass


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--duration", "0"], "--duration: 0; from 0.5 to 100000"),
        (["--rounds", "0"], "--rounds: 0; 1 or more"),
        (["--whole"], "--whole: given without --against; both or none"),
        (["nonsense"], "nonsense"),
        (["--against", "v1", "--repository", "/"], "--against v1: fatal: not a git repository"),
    ],
)
def test_invalid_options_are_refused_in_one_line(loop, tmp_path, monkeypatch, capsys, words, said):
    monkeypatch.chdir(tmp_path)
    code, err = loop.main(words), capsys.readouterr().err
    assert code == 2 and said in err and len(err.splitlines()) == 1
    assert not list(tmp_path.iterdir())


def test_script_writes_tables_and_json(loop, against, tmp_path, monkeypatch, capsys):
    """A stand-in that takes half as long replaces the other version."""
    row = {"step: clock, ms": 8.0, "step: processor, ms": 6.0, "places": "p"}
    monkeypatch.setattr(
        against, "_measure", lambda version, *_, **__: {
            name: value / 2 if version and name != "places" else value for name, value in row.items()
        }
    )  # fmt: skip
    monkeypatch.setattr(
        import_module("loop_result"), "unpacked", lambda reference, repository: nullcontext(tmp_path)
    )
    out = tmp_path / "out"
    words = ["--duration", "0.5", "--against", "old", "--rounds", "2", "--out", str(out)]
    assert loop.main(words) == 0
    said = capsys.readouterr().out
    assert "star against old" in said and "2.00 to 2.00" in said and "the same places" in said
    content = json.loads((out / "loop.json").read_text())
    assert content["comparisons"][0]["ratios"][0]["ratio"] == 2.0
    assert content["scenarios"][0]["steps"] == 6
    assert sum(content["scenarios"][0]["share"].values()) == pytest.approx(1.0)
