"""Parameters of the library in its messages, and options in those of the command line."""

import ast
import re

import pytest
from command_line import assert_refused, call, verbs
from source_files import SOURCE_FILES, syntax_tree

import skyherd
from skyherd.cli.keywords import OPTIONS, error_lines, with_options
from skyherd.errors import InputError, OutputError, join_errors
from skyherd.runner import run_mission

MODULES = {name: path for name, path in SOURCE_FILES.items() if not name.startswith("skyherd.cli")}
COMMAND = re.compile(r"(^|`)(skyherd|dask) [a-z][^`]*(`|$)")


def texts(tree):
    """Yield the texts of a module other than docstrings, and other than the arguments of programs."""
    skipped = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant):
            skipped.add(node.value)
        if isinstance(node, ast.List | ast.Tuple):
            skipped.update(one for one in node.elts if isinstance(one, ast.Constant))
        if isinstance(node, ast.JoinedStr):
            parts = [one.value if isinstance(one, ast.Constant) else "X" for one in node.values]
            skipped.update(one for one in node.values if isinstance(one, ast.Constant))
            yield "".join(map(str, parts))
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and node not in skipped:
            yield node.value


@pytest.mark.parametrize("name", MODULES)
def test_library_names_no_option_of_the_command_line(name):
    for text in texts(syntax_tree(MODULES[name])):
        assert not re.search(r"(^|\s)--[a-z]", COMMAND.sub("", text)), text
        for keyword in re.findall(r"`(\w+)=[^`]*`", text):
            assert keyword in {*OPTIONS, "X"}, text


def test_options_of_keywords_exist():
    known = {name for _, command in verbs() for one in command.params for name in one.opts}
    assert set(OPTIONS.values()) <= known


@pytest.mark.parametrize(
    ("text", "printed"),
    [
        ("replace it with `force=True`", "replace it with --force"),
        ("another `folder=`, or none", "another --out, or none"),
        ("try `border_bits=2` `inverted=False`", "try --border-bits 2 without --inverted"),
        ("see `skyherd run --help`, or `other=3`", "see `skyherd run --help`, or `other=3`"),
    ],
)
def test_keywords_are_printed_as_options(text, printed):
    assert with_options(text) == printed


def test_place_of_a_problem_is_printed_as_option(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    problems = [
        InputError("seed", "-1", "0 or more"),
        InputError("settings: control.k", "0", "above 0"),
        InputError("settings", "'k' is not of the form KEY=VALUE", "such as control.k=0.2"),
        InputError("mine.toml: seed", "-1", "0 or more"),
    ]
    assert error_lines(join_errors(problems)) == [
        "--seed: -1; 0 or more",
        "--set control.k: 0; above 0",
        "--set: 'k' is not of the form KEY=VALUE; such as control.k=0.2",
        "mine.toml: seed: -1; 0 or more",
    ]
    assert error_lines(OutputError("no memory; fewer `jobs=`")) == ["no memory; fewer --jobs"]
    (tmp_path / "seed").touch()
    assert error_lines(problems[0]) == ["seed: -1; 0 or more"]


def test_existing_folder_is_refused_in_the_words_of_its_caller(tmp_path, capsys):
    (tmp_path / "out").mkdir()
    with pytest.raises(InputError) as refused:
        run_mission(skyherd.load_mission("triangle"), tmp_path / "out")
    assert refused.value.allowed == "choose another `folder=`, or write into it with `force=True`"
    refused = call(capsys, "run", "triangle", "--out", tmp_path / "out")
    assert_refused(refused, "out: exists; choose another --out, or write into it with --force\n")


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ("run star --set k", "--set: 'k' is not of the form KEY=VALUE; such as control.k=0.2"),
        ("run star --set control.k=-1", "--set control.k: -1; a finite number from "),
        ("detect a.png --dictionary 4X4_51", "--dictionary: no dictionary '4X4_51'; did you mean '4X4_50'?"),
        ("detect a.png --detector photometrik", "--detector: no detector 'photometrik'; did you mean"),
        ("track a.mp4 --shape ring", "--shape: no shape 'ring'; one of circle, "),
        ("export . --format xml", "--format: no format 'xml'; one of csv, "),
        ("markers --ids 9-3 --side 3cm --out a.pdf", "--ids: '9-3' runs backwards; write 3-9"),
        (
            "markers --ids 99 --side 3cm --out a.pdf",
            "--ids: 99 is not in 4X4_50; 0 to 49, or a larger --dictionary",
        ),
        ("markers --ids 1 --side 3cm --paper A9 --out a.pdf", "--paper: no paper 'A9'; one of A5, "),
        ("play --host no-such-host.invalid", "--host: no such address 'no-such-host.invalid'; "),
        ("live run webcams --duration 0", "--duration: 0; a number of seconds above 0, "),
        ("live run webcams --cameras 1,2,3", "--cameras: 3 addresses; 2, as in the lab"),
        ("ros2 udp://x --marker-side-m 0.1", "--marker-side-m: given without a calibration; --camera too, "),
        ("study noise --scheduler here", "--scheduler: 'here' is not an address; such as tcp://"),
    ],
)
def test_wrong_value_is_refused_by_its_option(arguments, said, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert_refused(call(capsys, *arguments.split()), f"error: {said}")
