"""Words that CONTRIBUTING rules out, and the length of test names, in the whole tree."""

import ast
import io
import re
import tokenize
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
FOLDERS = (
    ".ci",
    ".github",
    "benchmarks",
    "control",
    "datasets",
    "docs",
    "examples",
    "render",
    "src",
    "tests",
    "vision",
)
EXEMPT = ("CHANGELOG.md", "vision/photometric/")
"""Beginnings of the paths that are exempt from the list of words."""

MAX_NAME = 60
"""Characters of the longest test name. Chosen: it fits a line of pytest's report."""


def unused_words() -> list[str]:
    """Return the words of CONTRIBUTING's table of words that are not used."""
    section = (ROOT / "CONTRIBUTING.md").read_text("utf-8").partition("\n## Text\n")[2].partition("\n## ")[0]
    return re.findall(r"^\| `([a-z ]+)` \|", section, re.M)


WORDS = re.compile(r"\b(" + "|".join(unused_words()).replace(" ", r"\s+") + r")\b", re.I)


def files(suffix: str) -> list[Path]:
    """Return the files of the tree with a suffix; links to packages, made for editors, are left out."""
    top = [path for path in ROOT.iterdir() if path.suffix == suffix]
    below = [path for folder in FOLDERS for path in (ROOT / folder).rglob(f"*{suffix}")]
    mapped = [ROOT / "src" / "skyherd" / name for name in ("control", "datasets", "render", "vision")]
    return sorted(path for path in top + below if not any(folder in path.parents for folder in mapped))


@cache
def parsed(path: Path) -> ast.Module:
    """Return the syntax tree of a file."""
    return ast.parse(path.read_text("utf-8"))


def python_prose(source: str, tree: ast.Module) -> Iterator[tuple[int, str]]:
    """Yield the line and the text of each docstring, also of constants, and of each block of comments."""
    for node in ast.walk(tree):
        value = node.value if isinstance(node, ast.Expr) else None
        if isinstance(value, ast.Constant) and isinstance(value.value, str):
            yield value.lineno, value.value
    block: list[tuple[int, str]] = []
    for token in tokenize.generate_tokens(io.StringIO(source).readline):
        if token.type != tokenize.COMMENT:
            continue
        if block and token.start[0] != block[-1][0] + 1:
            yield block[0][0], "\n".join(text for _, text in block)
            block = []
        block.append((token.start[0], token.string.lstrip("#: ")))
    if block:
        yield block[0][0], "\n".join(text for _, text in block)


def found_words(text: str) -> list[tuple[int, str]]:
    """Return the unused words in a text, without its code, each with its line from 0."""
    plain = re.sub(r"```.*?```|`[^`]*`", lambda code: "`" + "\n" * code[0].count("\n"), text, flags=re.S)
    return [(plain[: one.start()].count("\n"), " ".join(one[0].split())) for one in WORDS.finditer(plain)]


def long_names(tree: ast.Module) -> list[str]:
    """Return the names of tests that are longer than `MAX_NAME`."""
    functions = (node for node in ast.walk(tree) if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef))
    return [node.name for node in functions if node.name.startswith("test_") and len(node.name) > MAX_NAME]


def is_exempt(path: Path) -> bool:
    """Return whether a file may use every word."""
    return path.relative_to(ROOT).as_posix().startswith(EXEMPT)


def words_in_tree() -> list[str]:
    """Return path, line and word of each unused word of the tree."""
    found = []
    for path in files(".py") + files(".md"):
        if is_exempt(path):
            continue
        text = path.read_text("utf-8")
        texts = python_prose(text, parsed(path)) if path.suffix == ".py" else [(1, text)]
        place = path.relative_to(ROOT).as_posix()
        found += [
            f"{place}:{first + line}: {word}" for first, prose in texts for line, word in found_words(prose)
        ]
    return found


def names_in_tree() -> list[str]:
    """Return path and name of each test whose name is too long."""
    tests = [path for path in files(".py") if path.relative_to(ROOT).parts[0] == "tests"]
    return [
        f"{path.relative_to(ROOT).as_posix()}: {name}" for path in tests for name in long_names(parsed(path))
    ]


def test_prose_has_no_unused_word() -> None:
    found = words_in_tree()
    assert not found, "\n".join(["words that CONTRIBUTING.md replaces:", *found])


def test_test_names_have_at_most_60_characters() -> None:
    found = names_in_tree()
    assert not found, "\n".join([f"names of more than {MAX_NAME} characters:", *found])


def test_check_reads_words_and_files_of_the_tree() -> None:
    assert len(unused_words()) >= 11
    paths = {path.relative_to(ROOT).as_posix() for path in files(".py") + files(".md")}
    assert {"README.md", "docs/index.md", "vision/__init__.py", "tests/test_prose.py"} <= paths
    assert [is_exempt(ROOT / name) for name in ("CHANGELOG.md", "README.md")] == [True, False]


@pytest.mark.parametrize(
    "source",
    [
        '"""{} here."""',
        'def f():\n    """Return a value.\n\n    {} here.\n    """',
        'class C:\n    x = 1\n    """{} here."""',
        "x = 1  # {} here",
        'if x:\n    X = 1\n    """{} here."""',
    ],
)
@pytest.mark.parametrize("word", unused_words())
def test_check_finds_each_word_in_docstrings_and_comments(source, word) -> None:
    text = source.format(word.capitalize())
    found = [one for _, prose in python_prose(text, ast.parse(text)) for _, one in found_words(prose)]
    assert [one.lower() for one in found] == [word]


def test_check_finds_words_across_lines_but_not_in_code() -> None:
    comment = "x = 1\n# of which\n# there are two\ny = 2  # hardly\n"
    found = [(line, found_words(prose)) for line, prose in python_prose(comment, ast.parse(comment))]
    assert found == [(2, [(0, "of which there"), (2, "hardly")])]
    assert found_words("`a\nb` c\nall but\nfor one") == [(2, "but for")]
    assert found_words("`nobody` and\n```\n`hardly` anew\n```\nand a butler for anewton") == []
    string = 'x = "hardly a docstring"\n'
    assert not list(python_prose(string, ast.parse(string)))


def test_check_finds_a_name_of_61_characters() -> None:
    names = ["test_" + "x" * (length - 5) for length in (MAX_NAME, MAX_NAME + 1)]
    tree = ast.parse("class TestA:\n" + "".join(f"    async def {name}(self): ...\n" for name in names))
    assert long_names(tree) == names[1:]
