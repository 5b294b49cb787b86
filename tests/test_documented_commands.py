"""`benchmarks/documented_commands.py`: pages are split into commands, and sessions run them."""

import os
import re
import sys
import time
from pathlib import Path

import pytest

PAGE = """\
Save this as `a.toml`:

```toml
name = "a"
```

```sh
# a comment
mkdir a && cd a
skyherd run a.toml \\
    --no-video   # a comment
```

It prints `skyherd run NAME` and

```
shape reached: error 0.0017
601 steps, 16.5 s
```

and, with another file,

```
error: a.toml
```

`skyherd run b.toml --seed 2`, `skyherd run FILE`, `a_function()`,
`skyherd run a.toml --no-video # a comment`.

```python
import skyherd

print(1)
```

Save it as `plain.py`.
"""


@pytest.fixture(scope="module")
def program(load_benchmark):
    return load_benchmark("documented_commands")


@pytest.fixture
def shell(program, tmp_path):
    session = program.Session(["bash", "-c", program.BASH_LOOP], tmp_path, dict(os.environ))
    yield session
    session.close()


class TestPieces:
    def test_commands_examples_and_output_come_in_order(self, program) -> None:
        pieces = list(program.page_pieces(PAGE))
        assert [(piece.kind, piece.text) for piece in pieces if piece.kind != "toml"] == [
            ("sh", "mkdir a && cd a"),
            ("sh", "skyherd run a.toml --no-video # a comment"),
            ("python", "import skyherd\n\nprint(1)\n"),
            ("sh", "skyherd run b.toml --seed 2"),
        ]
        assert [piece.shown for piece in pieces if piece.shown] == [
            ("shape reached: error 0.0017", "601 steps, 16.5 s")
        ]
        names = [program.file_name(piece, PAGE) for piece in pieces if piece.kind != "sh"]
        assert names == ["a.toml", "plain.py"]

    def test_every_page_with_blocks_is_read(self, program) -> None:
        pieces = {page.name: program.pieces_of(page) for page in program.default_pages()}
        assert {"README.md", "tutorial.md", "from_image_to_plot.ipynb"} <= set(pieces)
        assert sum(len(of_page) for of_page in pieces.values()) > 150

    def test_each_entry_of_the_tables_has_its_command(self, program) -> None:
        pages = {page.relative_to(program.ROOT).as_posix(): page for page in program.default_pages()}
        for entry in [*program.TABLES["skip"], *program.TABLES["code"], *program.TABLES["until_ctrl_c"]]:
            texts = [p.text for name in entry.get("pages", pages) for p in program.pieces_of(pages[name])]
            assert any(re.search(entry["command"], text, re.MULTILINE) for text in texts), entry
        assert {name for entry in program.TABLES["given"] for name in entry["pages"]} <= set(pages)

    def test_every_skip_has_a_reason_and_the_tutorial_none(self, program) -> None:
        assert all(entry["why"] for entry in program.TABLES["skip"])
        for piece in program.pieces_of(program.ROOT / "docs/tutorial.md"):
            assert program.reason_to_skip("docs/tutorial.md", piece) is None, piece


class TestDifferences:
    def test_only_spaces_ellipses_and_wall_times_may_differ(self, program) -> None:
        shown = ("601 steps, 0 changes, 16.5 s", " unit  robots", "error: …", "rate 0.03735 /s")
        came = "601 steps, 0 changes, 99.0 s\nunit robots\nerror: a; b\nrate 0.03735 /s"
        assert program.differences(shown, came) == []

    @pytest.mark.parametrize("came", ["601 steps, 1 changes, 16.5 s", "rate 0.03736 /s", ""])
    def test_other_figures_are_reported(self, program, came) -> None:
        shown = ("601 steps, 0 changes, 16.5 s", "rate 0.03735 /s")
        assert program.differences(shown, came) == list(shown)


class TestSession:
    def test_shell_keeps_folder_and_variables_and_gives_codes(self, shell, tmp_path) -> None:
        assert shell.run("mkdir a && cd a && export B=2", 20).code == 0
        outcome = shell.run("pwd; echo $B; false", 20)
        assert (outcome.code, outcome.output.split()) == (1, [str(tmp_path / "a"), "2"])

    def test_command_beyond_its_limit_is_ended_with_its_children(self, shell, tmp_path) -> None:
        begin = time.monotonic()
        outcome = shell.run("sleep 60 & echo $! > child; sleep 60", 1.0)
        assert outcome.code is None and time.monotonic() - begin < 20
        assert shell.ended
        status = Path("/proc", (tmp_path / "child").read_text().strip(), "stat")
        assert not status.exists() or " Z " in status.read_text()

    def test_python_keeps_names_and_reports_an_error(self, program, tmp_path) -> None:
        session = program.Session([sys.executable, "-uc", program.PYTHON_LOOP], tmp_path, dict(os.environ))
        try:
            assert session.run("a = 3", 20).code == 0
            assert session.run("print(a + 1)", 20).output == "4\n"
            outcome = session.run("a / 0", 20)
            assert outcome.code == 1 and "ZeroDivisionError" in outcome.output
        finally:
            session.close()
