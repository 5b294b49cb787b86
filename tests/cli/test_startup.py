"""Modules loaded by `import skyherd` and by help, public names, and shell completion."""

import ast
import importlib
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from command_line import call
from source_files import SOURCE_FILES, syntax_tree

import skyherd
from skyherd.__main__ import BLAS_THREADS, main
from skyherd.cli import choices
from skyherd.inspection.table import FORMATS
from skyherd.markers.dictionary import canonical_name, dictionary_names
from skyherd.markers.sheet_layout import PAPERS_MM
from skyherd.vision import detector_names

PACKAGE = Path(skyherd.__file__).parent
HEAVY = (
    "numpy",
    "scipy",
    "cv2",
    "matplotlib",
    "pydantic",
    "PIL",
    "av",
    "mcap",
    "orjson",
    "rich",
    "dask",
    "pyarrow",
    "rosbags",
    "viser",
)
"""Modules that are slow to import, including rich: few verbs have progress bars and tables."""

VERBS = [
    [],
    ["run"],
    ["play"],
    ["view"],
    ["report"],
    ["export"],
    ["topology"],
    ["detect"],
    ["markers"],
    ["study"],
    ["scenario"],
    ["scenario", "check"],
    ["bench", "detectors"],
    ["dataset", "make"],
]


def loaded_by(*codes: str) -> list[set[str]]:
    """Return the top-level modules that a fresh interpreter has loaded after each piece of code."""
    script = "import sys"
    for code in codes:
        script += f"\ntry:\n    {code}\nexcept SystemExit: pass\nprint(*sys.modules, file=sys.stderr)"
    ended = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    lines = ended.stderr.splitlines()
    assert len(lines) == len(codes), ended.stderr
    return [{name.split(".")[0] for name in line.split()} for line in lines]


def test_package_import_loads_no_heavy_module():
    (loaded,) = loaded_by("import skyherd; assert skyherd.__version__; dir(skyherd)")
    assert "skyherd" in loaded
    assert loaded.isdisjoint({*HEAVY, "typer"})


def test_help_loads_no_heavy_module():
    """One process runs all verbs, since loaded modules stay; the first verb that loads one is reported."""
    helps = [
        f"from skyherd.__main__ import main; sys.argv[1:] = {[*verb, '--help']}; main()" for verb in VERBS
    ]
    for verb, loaded in zip(VERBS, loaded_by(*helps), strict=True):
        by_typer = {"pydantic"} if verb else set()  # recent versions of typer check a verb's parameters by it
        assert "typer" in loaded
        assert loaded.isdisjoint(set(HEAVY) - by_typer), verb


def test_check_of_loaded_modules_detects_numpy():
    """Negative control: access to a public name loads NumPy."""
    assert {"numpy", "scipy"} <= loaded_by("import skyherd; skyherd.Template")[0]


@pytest.mark.skipif(not Path("/proc/self/task").exists(), reason="threads are counted by Linux")
@pytest.mark.parametrize(("given", "expected"), [(None, 1), ("3", 3)])
def test_linear_algebra_has_one_thread_unless_told(given, expected):
    """NumPy makes its threads when it is loaded; the environment of a user counts."""
    code = "import os, sys; from skyherd.__main__ import main; sys.argv = ['skyherd', '--help']"
    code += "\ntry: main()\nexcept SystemExit: pass"
    code += "\nimport numpy; print(len(os.listdir('/proc/self/task')), file=sys.stderr)"
    environment = {
        name: value for name, value in os.environ.items() if name not in [*BLAS_THREADS, "OMP_NUM_THREADS"]
    }
    environment |= {} if given is None else {"OPENBLAS_NUM_THREADS": given}
    ended = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, env=environment
    )
    assert int(ended.stderr) == min(expected, len(os.sched_getaffinity(0)))


def test_live_modules_load_no_matplotlib():
    """Live processes start on small computers, and only figures need Matplotlib."""
    datasets, unit = loaded_by("import skyherd.datasets", "import skyherd.live.unit_process")
    assert "numpy" in datasets
    assert "matplotlib" not in datasets | unit


def top_imports(path: Path) -> set[str]:
    """Return the modules that a file imports when it is loaded, without those under `if TYPE_CHECKING`."""
    found = set()
    for node in ast.parse(path.read_text()).body:
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            found.add(node.module)
    return found


@pytest.mark.parametrize("path", sorted((PACKAGE / "cli").glob("*.py")), ids=lambda path: path.name)
def test_verb_module_imports_only_light_modules_at_top(path):
    light = ("typer", "skyherd.errors", "skyherd.text", "skyherd.version", "skyherd.cli")
    heavy = {name for name in top_imports(path) if not name.startswith(light)} - sys.stdlib_module_names
    assert {name for name in heavy if name.split(".")[0] not in sys.stdlib_module_names} == set()


def test_public_name_is_the_object_of_its_package():
    for name, module in skyherd._MODULE_BY_NAME.items():
        assert getattr(skyherd, name) is getattr(importlib.import_module(module), name)
    assert sorted(skyherd.__all__) == sorted([*skyherd._MODULE_BY_NAME, "__version__"])
    assert set(skyherd.__all__) <= set(dir(skyherd))
    with pytest.raises(AttributeError, match="no attribute 'nonsense'"):
        skyherd.nonsense  # noqa: B018


def test_type_checkers_see_equal_names_from_equal_modules():
    tree = ast.parse((PACKAGE / "__init__.py").read_text())
    block = next(node for node in tree.body if isinstance(node, ast.If))
    seen = {alias.name: node.module for node in block.body for alias in node.names}
    assert seen == skyherd._MODULE_BY_NAME


def test_no_module_imports_the_top_package():
    """Such an import would be circular."""
    for path in SOURCE_FILES.values():
        if not re.search(r"from\s+skyherd\s+import|import\s.*\bskyherd\b(?![.\w])", path.read_text("utf-8")):
            continue  # parse only files with this text, since parsing takes most of the time
        for node in ast.walk(syntax_tree(path)):
            names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            assert "skyherd" not in names, path
            assert not (isinstance(node, ast.ImportFrom) and node.module == "skyherd"), path


def test_help_and_completion_lists_match_the_code():
    assert list(choices.DETECTORS) == detector_names()
    assert list(choices.PAPERS) == list(PAPERS_MM)
    assert choices.TABLE_FORMATS == FORMATS
    assert sorted(choices.DICTIONARIES) == sorted({canonical_name(name) for name in dictionary_names()})


def test_help_names_option_values(capsys):
    said = " ".join(call(capsys, "detect", "--help")[1].split()).replace(
        "- ", "-"
    )  # lines end at hyphens, too
    assert all(name in said for name in detector_names())
    said = " ".join(call(capsys, "markers", "--help")[1].split())
    assert all(name in said for name in (*PAPERS_MM, *choices.DICTIONARIES))


@pytest.fixture(params=["here", pytest.param("in a process of its own", marks=pytest.mark.slow)])
def completions(request, tmp_path, monkeypatch, capfd):
    """Return bash's completions in a folder for the last of some words, requested as its script does."""

    def ask(*words: str) -> list[str]:
        monkeypatch.chdir(tmp_path)
        monkeypatch.setattr(sys, "argv", ["skyherd"])
        monkeypatch.setenv("_SKYHERD_COMPLETE", "complete_bash")
        monkeypatch.setenv("COMP_WORDS", " ".join(["skyherd", *words]))
        monkeypatch.setenv("COMP_CWORD", str(len(words)))
        if request.param == "here":
            with pytest.raises(SystemExit):
                main()
        else:
            code = "import sys; sys.argv = ['skyherd']; from skyherd.__main__ import main; main()"
            subprocess.run([sys.executable, "-c", code], check=False)
        said = capfd.readouterr()
        assert said.err == ""
        return said.out.split()

    return ask


@pytest.mark.parametrize(
    ("words", "offered"),
    [
        (["sce"], ["scenario"]),
        (["scenario", "ch"], ["check"]),
        (["run", "sta"], ["star", "star-consumer"]),
        (["run", "mi"], ["mine.toml"]),
        (["run", "fol"], ["folder/"]),
        (["run", "folder/"], ["folder/other.toml"]),
        (["run", "star", "--perception", "i"], ["ideal"]),
        (["detect", "a.png", "--detector", "ph"], ["photometric"]),
        (["detect", "a.png", "--format", "j"], ["jsonl"]),
        (["markers", "--paper", "Let"], ["Letter"]),
        (["markers", "--dictionary", "5X5_19"], ["5X5_1900"]),
        (["dataset", "make", "sm"], ["small"]),
        (["study", "noi"], ["noise"]),
        (["export", "a", "--format", "p"], ["parquet"]),
    ],
    ids=lambda value: " ".join(value),
)
def test_shell_completes_verbs_options_and_values(tmp_path, completions, words, offered):
    (tmp_path / "folder").mkdir()
    for name in ("mine.toml", "folder/other.toml", "folder/notes.txt"):
        (tmp_path / name).write_text("")
    assert completions(*words) == offered


def test_completion_script_is_printed_and_calls_program(capsys, monkeypatch):
    monkeypatch.setenv("_TYPER_COMPLETE_TEST_DISABLE_SHELL_DETECTION", "1")
    code, said, _ = call(capsys, "--show-completion", "bash")
    assert code == 0
    assert "_SKYHERD_COMPLETE=complete_bash" in said
