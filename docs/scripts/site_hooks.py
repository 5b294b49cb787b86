"""Hooks of MkDocs: pages made from the code, and pages that lie outside of `docs/`.

The references of the command line, of scenario files and of the library are made while the site is built, so
that they cannot be out of date. `ARCHITECTURE.md`, `CONTRIBUTING.md` and its like lie at the root of
the repository, where people look for them; they become pages of the site, their links changed to the site's.
The replays of the gallery are shown by viser's client, which is taken from the installed package.
"""

import re
import shutil
import tempfile
from importlib import resources
from pathlib import Path

from api_reference import ROOT, api_page, overview, packages, public_page
from cli_reference import cli_reference
from formulas import with_mathml
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.exceptions import PluginError
from mkdocs.plugins import event_priority
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page
from scenario_reference import scenario_reference

API = "reference/api"
ROOT_PAGES = {
    "architecture.md": "ARCHITECTURE.md",
    "contributing.md": "CONTRIBUTING.md",
    "changelog.md": "CHANGELOG.md",
    "security.md": "SECURITY.md",
}
REPLAY_PAGE = "gallery/replay.html"
"""Viser's client: `replay.html?playbackPath=star.viser` shows one run."""
INTERNALS = "Internals"
SEARCH_BOOSTS = {"Home": 3.0, "How to": 3.0, "Guides": 2.0, "Live": 2.0, "Reference": 1.0, INTERNALS: 0.3}
"""Factor on the search score of a page, by its innermost section that is listed. Chosen: guides first, then
references, then the pages of internal modules, which repeat every term."""
PARTS = ("control", "datasets", "render", "vision")
_temporary: list[Path] = []


@event_priority(100)
def on_config(config: MkDocsConfig) -> MkDocsConfig:
    """Give mkdocstrings a tree of the usual layout, and put the library's pages into the navigation.

    The folders `control/`, `datasets/`, `render/` and `vision/` become packages of `skyherd` when it is
    installed; docstrings are read from the source files, which are copied into a folder for that.
    """
    tree = Path(tempfile.mkdtemp(prefix="skyherd-docs-"))
    _temporary.append(tree)
    ignore = shutil.ignore_patterns("__pycache__")
    shutil.copytree(ROOT / "src/skyherd", tree / "skyherd", ignore=ignore)
    for part in PARTS:
        shutil.rmtree(tree / "skyherd" / part, ignore_errors=True)  # the copy of an editor's link
        shutil.copytree(ROOT / part, tree / "skyherd" / part, ignore=ignore)
    config.plugins["mkdocstrings"].config.handlers["python"]["paths"] = [str(tree)]
    library = next(entry["Reference"] for entry in config.nav if "Reference" in entry)
    library.append({INTERNALS: [f"{API}/index.md", *(f"{API}/{package}.md" for package in packages())]})
    return config


def on_files(files: Files, *, config: MkDocsConfig) -> Files:
    """Add the pages made from the code, those from the root of the repository, and viser's client."""
    made = {
        "reference/cli.md": cli_reference(),
        "reference/scenario.md": scenario_reference(),
        "reference/library.md": public_page(),
        f"{API}/index.md": overview(),
        **{f"{API}/{package}.md": api_page(package, folder) for package, folder in packages().items()},
        **{page: from_root((ROOT / name).read_text()) for page, name in ROOT_PAGES.items()},
    }
    client = resources.files("viser") / "client/build/index.html"
    made[REPLAY_PAGE] = client.read_text(encoding="utf-8")
    for path, text in made.items():
        files.append(File.generated(config, path, content=text))
    return files


def on_page_markdown(markdown: str, *, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Set how high the search ranks a page, and link the repository on the home page."""
    sections = [section.title for section in page.ancestors]
    boosts = [SEARCH_BOOSTS[title] for title in sections if title in SEARCH_BOOSTS]
    page.meta.setdefault("search", {}).setdefault("boost", boosts[0] if boosts else 1.0)
    link = f"[Repository]({config.repo_url}) · " if config.repo_url else ""
    return markdown.replace("<!-- repository -->", link)


def on_page_content(html: str, *, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Replace TeX by MathML.

    Raises:
        PluginError: a formula of the page cannot be converted.
    """
    try:
        return with_mathml(html)
    except ValueError as error:
        raise PluginError(f"{page.file.src_uri}: {error}") from error


def from_root(text: str) -> str:
    """Return a page of the repository's root with links that work on the site."""
    names = {name: page for page, name in ROOT_PAGES.items()}
    text = re.sub(r"\]\(docs/", "](", text)
    return re.sub(r"\]\(([A-Z]+\.md)", lambda match: f"]({names.get(match[1], match[1])}", text)


def on_shutdown() -> None:
    """Remove the copied tree."""
    for tree in _temporary:
        shutil.rmtree(tree, ignore_errors=True)
