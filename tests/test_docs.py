"""Documentation against the code: its paths, commands, options and scenarios exist."""

import ast
import importlib
import importlib.util
import inspect
import re
import shlex
import tomllib
from pathlib import Path

import pytest
import typer

import skyherd
from skyherd.cli import app
from skyherd.datasets import Scenario, load_mission

ROOT = Path(__file__).parent.parent
DOCS = ROOT / "docs"
PAGES = sorted([*DOCS.rglob("*.md"), *ROOT.glob("*.md")])
GROUP = typer.main.get_command(app)


def script(name: str):
    """Return a module of docs/scripts, which is not a package."""
    spec = importlib.util.spec_from_file_location(name, DOCS / "scripts" / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def page_id(path: Path) -> str:
    return path.relative_to(ROOT).as_posix()


@pytest.mark.parametrize("page", [page for page in PAGES if page.name != "CHANGELOG.md"], ids=page_id)
def test_code_files_that_a_page_names_exist(page) -> None:
    for name in re.findall(r"`(?:python )?((?:\w+/)+\w+\.(?:py|toml))", page.read_text()):
        assert (ROOT / name).is_file(), f"{page.name} names {name}"


def commands(page: Path) -> list[list[str]]:
    """Return calls of the program in a page's shell examples and in its code, as words."""
    text = page.read_text()
    lines = [line for block in re.findall(r"```sh\n(.*?)```", text, re.S) for line in block.splitlines()]
    lines += re.findall(r"`(skyherd [^`]*)`", re.sub(r"```.*?```", "", text, flags=re.S))
    calls = [line[line.index("skyherd ") :] for line in lines if re.match(r"(\S*/)?skyherd ", line)]
    return [shlex.split(call.replace("\\|", "/"), comments=True)[1:] for call in calls]


@pytest.mark.parametrize("page", PAGES, ids=page_id)
def test_verbs_and_options_on_a_page_exist(page) -> None:
    for words in commands(page):
        command, rest = GROUP, list(words)
        while rest and rest[0] in getattr(command, "commands", {}):
            command = command.commands[rest.pop(0)]
        assert command is not GROUP or words[0] in ("VERB", "--help", "--version", "--install-completion"), (
            words
        )
        known = {option for parameter in command.params for option in parameter.opts} | {"--help"}
        if command is not GROUP and not hasattr(command, "commands"):
            assert {word for word in rest if word.startswith("--")} <= known, words


def test_pages_with_commands_are_found() -> None:
    """Negative control of the test above."""
    assert ["run", "star"] in commands(DOCS / "how-to/run.md")
    assert sum(len(commands(page)) for page in PAGES) > 40


def leaves(command, name: str = ""):
    for word, below in getattr(command, "commands", {}).items():
        yield from (
            leaves(below, f"{name} {word}") if hasattr(below, "commands") else [(f"{name} {word}", below)]
        )


def test_command_line_reference_has_every_verb_and_option() -> None:
    text = script("cli_reference").cli_reference()
    parts = dict(zip(*[iter(re.split(r"^## `skyherd( .*)`$", text, flags=re.M)[1:])] * 2, strict=True))
    assert list(parts) == [name for name, _ in leaves(GROUP)]
    for name, verb in leaves(GROUP):
        for parameter in verb.params:
            assert parameter.param_type_name == "argument" or f"`{parameter.opts[0]}" in parts[name]


def test_reference_links_each_name_to_the_module_that_defines_it() -> None:
    reference, linked = script("api_reference"), 0
    for package, folder in reference.packages().items():
        for name, module in reference.offered_names(package, folder).items():
            found = getattr(importlib.import_module(module), name)
            if inspect.isclass(found) or inspect.isfunction(found):
                assert found.__module__ == module, (package, name)
                linked += 1
    assert linked > 100


def test_scenario_reference_has_every_key() -> None:
    text = script("scenario_reference").scenario_reference()
    schema = Scenario.model_json_schema()
    for name, model in {"Top": schema, **schema["$defs"]}.items():
        heading = "## Top level" if name == "Top" else f"{{ #{name.lower()} }}"
        part = text.split(heading, 1)[1].split("\n## ", 1)[0]
        for key in model["properties"]:
            assert f"| `{key}` |" in part, (name, key)
    assert "## `units[].camera`" in text


def test_every_verb_has_a_how_to_and_every_page_a_place() -> None:
    nav = re.findall(r"([\w/-]+\.md)", (ROOT / "mkdocs.yml").read_text())
    assert {f"how-to/{word}.md" for word in GROUP.commands} <= set(nav)
    assert {page.relative_to(DOCS).as_posix() for page in DOCS.rglob("*.md")} <= set(nav)


def test_tutorial_scenarios_are_valid_and_error_is_as_shown(tmp_path) -> None:
    text = (DOCS / "tutorial.md").read_text()
    files = re.findall(r"```toml\n(.*?)```", text, re.S)
    assert [tomllib.loads(file)["name"] for file in files] == ["arrow", "two"]
    for file in files:
        (tmp_path / "a.toml").write_text(file)
        assert load_mission(str(tmp_path / "a.toml")).ids.size == 7
    (tmp_path / "a.toml").write_text(files[0].replace("height_m = 12.0", "height_m = -12.0"))
    with pytest.raises(ValueError) as wrong:
        load_mission(str(tmp_path / "a.toml"))
    shown = next(line for line in text.splitlines() if line.startswith("error: arrow.toml"))
    assert str(wrong.value).replace(str(tmp_path / "a.toml"), "arrow.toml") == shown.removeprefix("error: ")


def test_library_page_example_of_a_world_runs(capsys) -> None:
    blocks = re.findall(r"```python\n(.*?)```", (DOCS / "how-to/library.md").read_text(), re.S)
    for block in blocks:
        compile(block, "library.md", "exec")
    exec(next(block for block in blocks if "GoalInboxes" in block), {})
    assert "[0. 0. 0. 0.]" in capsys.readouterr().out


def test_architecture_page_lists_layers_of_the_contract() -> None:
    tool = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["importlinter"]
    layers = next(one["layers"] for one in tool["contracts"] if one["type"] == "layers")
    meant = [{name.strip() for name in layer.split("|")} for layer in reversed(layers)]
    rows = re.findall(r"^\| (\d+) \| (.*?) \|", (ROOT / "ARCHITECTURE.md").read_text(), re.M)
    told: dict[int, set[str]] = {}
    for number, names in rows:
        told.setdefault(int(number), set()).update(re.findall(r"`(\w+)`", names))
    assert [told[number] for number in sorted(told)] == [layer for layer in meant if layer != {"__main__"}]


def test_site_fetches_only_pinned_mathjax_from_elsewhere() -> None:
    text = (ROOT / "mkdocs.yml").read_text()
    assert "font: false" in text
    addresses = re.findall(r"http\S*", re.sub(r"#.*", "", text))
    assert len(addresses) == 1 and re.search(r"/mathjax@\d+\.\d+\.\d+/es5/tex-chtml\.js$", addresses[0])
    assert "http" not in (DOCS / "site.css").read_text() + (DOCS / "formulas.js").read_text()


class TestFormulas:
    def test_tex_moves_into_attribute_and_mathml_is_shown(self) -> None:
        html = '<p>A <span class="arithmatex">\\(a &lt; \\bar{q}_i\\)</span> b</p>'
        made = script("formulas").with_mathml(html)
        assert 'data-tex="\\(a &lt; \\bar{q}_i\\)"' in made and "<math" in made
        assert "\\" not in re.sub(r"<[^>]*>", "", made)

    def test_formula_that_mathml_cannot_show_is_refused(self) -> None:
        tex = r"\begin{aligned} a &amp;= b \end{aligned}"
        with pytest.raises(ValueError, match="no MathML"):
            script("formulas").with_mathml(f'<div class="arithmatex">\\[{tex}\\]</div>')

    def test_page_without_formulas_is_unchanged(self) -> None:
        html = "<p>costs 3 $ and <code>\\(x\\)</code></p>"
        assert script("formulas").with_mathml(html) == html


def test_public_api_page_has_each_name_of_the_package_once() -> None:
    reference = script("api_reference")
    listed = [name for names in reference.PUBLIC.values() for name in names]
    assert sorted(listed) == sorted(set(skyherd.__all__) - {"__version__"})
    shown = re.findall(r"^::: skyherd\.[\w.]*\b(\w+)$", reference.public_page(), re.M)
    assert shown == listed


def test_search_ranks_guides_above_references_and_internals() -> None:
    text = (DOCS / "scripts/site_hooks.py").read_text().replace("INTERNALS: ", '"Internals": ')
    boosts = ast.literal_eval(re.search(r"^SEARCH_BOOSTS = ({.*?})$", text, re.M | re.S)[1])
    tabs = re.findall(r"^  - ([\w ]+):", (ROOT / "mkdocs.yml").read_text().split("\nnav:\n")[1], re.M)
    assert set(boosts) <= {*tabs, "Internals"}
    assert min(boosts["How to"], boosts["Guides"], boosts["Live"]) > boosts["Reference"] > boosts["Internals"]


class TestReadme:
    TEXT = (ROOT / "README.md").read_text()

    def test_is_short(self) -> None:
        assert len(self.TEXT.splitlines()) <= 150
        assert len(self.TEXT.split()) <= 900

    def test_marks_the_blocks_that_the_gate_runs(self) -> None:
        for mark in ("run", "test"):
            assert re.search(rf"^<!-- {mark} -->\n```sh\npython3 -m venv .*\n```$", self.TEXT, re.M)

    def test_example_runs_and_prints_errors_and_detections(self, capsys) -> None:
        (example,) = re.findall(r"```python\n(.*?)```", self.TEXT, re.S)
        assert len(example.splitlines()) <= 12
        exec(example, {})
        lines = capsys.readouterr().out.splitlines()
        errors = [float(line.split()[-1]) for line in lines if "shape error" in line]
        assert len(errors) == 21 and errors[-1] < errors[0]
        assert len([line for line in lines if "sigma" in line]) >= 10

    def test_software_citation_names_the_version(self) -> None:
        assert f"version = {{{skyherd.__version__}}}" in self.TEXT


def test_gallery_is_small_and_the_home_page_shows_all_of_it() -> None:
    home, folder = (DOCS / "index.md").read_text(), DOCS / "gallery"
    films = re.findall(r'^    "(\w+)": Film\(', (DOCS / "scripts/gallery.py").read_text(), re.M)
    assert len(films) >= 4
    kinds = (".mp4", "-phone.mp4", ".jpg", ".viser")
    assert {path.name for path in folder.iterdir()} == {f"{film}{kind}" for film in films for kind in kinds}
    for film in films:
        assert f'<source src="gallery/{film}-phone.mp4" media="(max-width: 600px)">' in home
        assert f'<source src="gallery/{film}.mp4">' in home and f'poster="gallery/{film}.jpg"' in home
        assert f"`skyherd run {film}`" in home
        assert f"(gallery/replay.html?playbackPath={film}.viser)" in home
        assert (folder / f"{film}.viser").stat().st_size < 1.5e6
    for kind in ("*[!e].mp4", "*-phone.mp4"):
        assert sum(path.stat().st_size for path in folder.glob(kind)) < 6e6
