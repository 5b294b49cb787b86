"""Run every documented command and Python example as written, each page in a fresh clone.

    python benchmarks/documented_commands.py README.md docs/tutorial.md

The pages are README, the documentation and the examples. A line is printed for each command, with its seconds
and exit code. Output that a page shows is compared with the output that came. Commands run in a new
environment with `pip install '.[live,peers,play,study]'` of the last commit, or in that of `--environment`.
`documented_commands.toml` lists the commands that are skipped, and why, and the files that a reader has.
"""

import argparse
import json
import os
import re
import selectors
import shlex
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import tomllib
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

ROOT = Path(__file__).parent.parent
TABLES = tomllib.loads(Path(__file__).with_suffix(".toml").read_text("utf-8"))

LIMIT_S = 1200.0
"""Time after which a command is ended and counts as failed, s. Chosen: four times that of the longest."""

BASH_LOOP = 'while read -r file; do source "$file" </dev/null 2>&1; printf "\\x1e%s\\n" $?; done'

PYTHON_LOOP = """
import sys, traceback
sys.path.insert(0, "")
sys.stderr, names = sys.stdout, {"__name__": "__main__"}
for line in sys.stdin:
    path, code = line.rstrip("\\n"), 0
    try:
        exec(compile(open(path, encoding="utf-8").read(), path, "exec"), names)
    except BaseException:
        traceback.print_exc()
        code = 1
    print(f"\\x1e{code}", flush=True)
"""

RUNNABLE = re.compile(r"(?:\S*/)?(skyherd|python|pip|pytest|mkdocs|docker) ")
"""Start of inline code that is a command."""

PLACEHOLDER = re.compile(r"(?<![\w./-])[A-Z]{2,}\b(?!=)|…")
"""Parts of inline code that the reader replaces, such as NAME; the code is then not run."""

WALL_TIME = re.compile(r", \d+\\\.\d s$")
"""Wall-clock time at the end of a line of output, which no two runs share, in an escaped line."""


@dataclass(frozen=True)
class Piece:
    """One command, example or file of a page.

    Attributes:
        kind: `sh`, `python`, or `toml` for a file to save.
        text: the command line, the example, or the file's text.
        shown: lines of output that the page shows for it.
    """

    kind: str
    text: str
    shown: tuple[str, ...] = ()

    @property
    def title(self) -> str:
        """The command, or the first line of an example."""
        lines = [line for line in self.text.strip().splitlines() if not line.startswith(("import ", "from "))]
        first = next((line for line in lines if line.strip()), self.text.strip().splitlines()[0])
        return first if self.kind == "sh" else f"[{self.kind}] {first}"


@dataclass
class Outcome:
    """Result of a command: seconds, exit code (None if it was ended at the limit), and output."""

    seconds: float
    code: int | None
    output: str


@dataclass
class Totals:
    """Numbers of commands over all pages, and the lines to repeat at the end."""

    ran: int = 0
    wrong: list[str] = field(default_factory=list)
    skipped: dict[str, list[str]] = field(default_factory=dict)


class Session:
    """Shell or Python process that runs pieces one after the other and keeps folder, variables and names."""

    def __init__(self, words: list[str], folder: Path, environment: dict[str, str]) -> None:
        self._pieces = Path(tempfile.mkdtemp(prefix="pieces-"))
        self._number = 0
        self._process = subprocess.Popen(
            words,
            cwd=folder,
            env=environment,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            start_new_session=True,
        )

    def run(self, text: str, limit_s: float) -> Outcome:
        """Run one piece; after `limit_s` end the session with all its processes."""
        assert self._process.stdin is not None and self._process.stdout is not None
        self._number += 1
        file = self._pieces / f"piece_{self._number}"
        file.write_text(text + "\n", encoding="utf-8")
        begin = time.monotonic()
        self._process.stdin.write(f"{file}\n".encode())
        self._process.stdin.flush()
        output = b""
        with selectors.DefaultSelector() as selector:
            selector.register(self._process.stdout, selectors.EVENT_READ)
            while not (end := re.search(rb"\x1e(\d+)\n", output)):
                left_s = begin + limit_s - time.monotonic()
                part = b""
                if left_s > 0 and selector.select(left_s):
                    part = os.read(self._process.stdout.fileno(), 65536)
                if not part:
                    self.close()
                    return Outcome(time.monotonic() - begin, None, output.decode(errors="replace"))
                output += part
        text = output[: end.start()].decode(errors="replace")
        return Outcome(time.monotonic() - begin, int(end[1]), text)

    @property
    def ended(self) -> bool:
        """True if the process has ended."""
        return self._process.poll() is not None

    def close(self) -> None:
        """End the session and all processes that it started, and wait for it."""
        for number in (signal.SIGTERM, signal.SIGKILL):
            try:
                os.killpg(self._process.pid, number)
            except ProcessLookupError:
                break
            try:
                self._process.wait(timeout=5)
            except subprocess.TimeoutExpired:
                continue
        self._process.wait()
        for pipe in (self._process.stdin, self._process.stdout):
            if pipe is not None:
                pipe.close()
        shutil.rmtree(self._pieces, ignore_errors=True)


def command_lines(block: str) -> list[str]:
    """Return the commands of a shell block: its lines without comments, continued lines joined."""
    joined = block.replace("\\\n", " ")
    lines = [line.strip() for line in joined.splitlines()]
    return [re.sub(r"\s+", " ", line) for line in lines if line and not line.startswith("#")]


def page_pieces(text: str) -> Iterator[Piece]:
    """Yield the fenced commands and examples of a Markdown page in order, then its inline commands.

    The first block without a language after a command is the output that the page shows for it. An inline
    command that a block has, or that has a placeholder such as NAME, is left out.
    """
    pieces: list[Piece] = []
    for language, body in re.findall(r"^```(\w*)\n(.*?)^```$", text, re.DOTALL | re.MULTILINE):
        if language == "sh":
            pieces += [Piece("sh", line) for line in command_lines(body)]
        elif language in ("python", "toml"):
            pieces.append(Piece(language, body))
        elif not language and pieces and pieces[-1].kind == "sh" and not pieces[-1].shown:
            shown = tuple(line for line in body.splitlines() if line.strip(" …"))
            pieces[-1] = Piece("sh", pieces[-1].text, shown)
    yield from pieces
    seen = {piece.text for piece in pieces}
    for code in re.findall(r"(?<!`)`([^`\n]+)`", re.sub(r"```.*?```", "", text, flags=re.DOTALL)):
        code = code.replace("\\|", "|")
        if RUNNABLE.match(code) and not PLACEHOLDER.search(code) and code not in seen:
            seen.add(code)
            yield Piece("sh", code)


def clone(folder: Path) -> None:
    """Clone the last commit of the checkout into a folder, which is replaced."""
    shutil.rmtree(folder, ignore_errors=True)
    subprocess.run(["git", "clone", "-q", str(ROOT), str(folder)], check=True)


def make_environment(work: Path) -> Path:
    """Make an environment with skyherd and its optional libraries, as the documentation installs them."""
    clone(work / "source")
    subprocess.run([sys.executable, "-m", "venv", "--clear", str(work / "environment")], check=True)
    pip = [str(work / "environment/bin/pip"), "install", "-q", f"{work / 'source'}[live,peers,play,study]"]
    subprocess.run(pip, check=True)
    return work / "environment"


def pieces_of(page: Path) -> list[Piece]:
    """Return the commands and examples of a Markdown page, a notebook, or a script of `examples/`."""
    text = page.read_text("utf-8")
    if page.suffix == ".ipynb":
        cells = [cell for cell in json.loads(text)["cells"] if cell["cell_type"] == "code"]
        return [Piece("python", "".join(cell["source"])) for cell in cells]
    if page.suffix == ".py":
        calls = re.findall(r"^    (python \S+\.py.*)$", text.split('"""')[1], re.MULTILINE)
        return [Piece("sh", call) for call in calls or [f"python {page.relative_to(ROOT)}"]]
    return list(page_pieces(text))


def default_pages() -> list[Path]:
    """Return README, all pages of the documentation, and the examples."""
    documents = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").rglob("*.md"))]
    examples = sorted(path for path in (ROOT / "examples").iterdir() if path.suffix in (".py", ".ipynb"))
    return [*documents, *examples]


def reason_to_skip(page: str, piece: Piece) -> str | None:
    """Return why a piece is not run, or None."""
    if piece.kind == "toml":
        return None
    for entry in TABLES["skip"]:
        if re.search(entry["command"], piece.text, re.MULTILINE) and page in entry.get("pages", [page]):
            return str(entry["why"])
    return None


def differences(shown: tuple[str, ...], output: str) -> list[str]:
    """Return the shown lines that no line of the output equals, up to spaces, `…` and wall-clock times."""
    came = [" ".join(line.split()) for line in output.splitlines()]
    missing = []
    for line in shown:
        pattern = re.escape(" ".join(line.split())).replace("…", ".*").replace("\\ ", " ")
        pattern = WALL_TIME.sub(r", [\\d.]+ s", pattern)
        if not any(re.fullmatch(pattern, other) for other in came):
            missing.append(line)
    return missing


def file_name(piece: Piece, text: str) -> str | None:
    """Return the name under which a page has its reader save a block, or None."""
    before, found, after = text.partition(piece.text)
    if not found:  # of a notebook, whose text is JSON
        return None
    named = re.search(r"[Ss]ave (?:this )?as\s`([\w.]+)`:\s*```\w+\n$", before)
    named = named or re.match(r"```\s*Saved? (?:it |this )?as `([\w.]+)`", after)
    return named[1] if named else None


class PageRun:
    """Run of one page in its own clone."""

    def __init__(self, page: Path, work: Path, environment: Path, totals: Totals) -> None:
        self.page, self.name, self.totals = page, page.relative_to(ROOT).as_posix(), totals
        self.folder, self.python = work / re.sub(r"\W+", "-", self.name), environment / "bin/python"
        clone(self.folder)
        self.variables = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
        self.variables |= {"PATH": f"{environment / 'bin'}:{os.environ['PATH']}", "COLUMNS": "200"}
        self.sessions: dict[str, Session] = {}

    def session(self, kind: str) -> Session:
        """Return the shell or the Python process of the page; start it if necessary."""
        if kind not in self.sessions or self.sessions[kind].ended:
            words = ["bash", "-c", BASH_LOOP] if kind == "sh" else [str(self.python), "-uc", PYTHON_LOOP]
            self.sessions[kind] = Session(words, self.folder, self.variables)
        return self.sessions[kind]

    def run(self) -> None:
        """Run all pieces of the page, print a line for each, and end what they started."""
        text = self.page.read_text("utf-8")
        try:
            self._prepare()
            for piece in pieces_of(self.page):
                self._run_piece(piece, text)
        finally:
            for session in self.sessions.values():
                session.close()

    def _prepare(self) -> None:
        """Make the files that the page's reader has, by the commands of the table."""
        for entry in TABLES["given"]:
            if self.name in entry["pages"]:
                outcome = self.session("sh").run(entry["make"], LIMIT_S)
                if outcome.code != 0:
                    raise SystemExit(f"error: {self.name}: {entry['make']}\n{outcome.output}")

    def _run_piece(self, piece: Piece, text: str) -> None:
        why = reason_to_skip(self.name, piece)
        if why is not None:
            self.totals.skipped.setdefault(why, []).append(f"{self.name}: {piece.title}")
            return
        name = file_name(piece, text) if piece.kind != "sh" else None
        if name is not None:
            self.session("sh").run(f"cat > {name} <<'END'\n{piece.text}END", LIMIT_S)
        if piece.kind == "toml":
            return
        outcome = self.session(piece.kind).run(self._as_run(piece), LIMIT_S)
        self.totals.ran += 1
        faults = self._faults(piece, outcome)
        code = "limit" if outcome.code is None else str(outcome.code)
        line = f"{self.name:26} {'WRONG' if faults else 'ok':6} {outcome.seconds:6.1f} s {code:>5}"
        print(f"{line}  {piece.title}", flush=True)
        if faults:
            self.totals.wrong.append(f"{self.name}: {piece.title}: {'; '.join(faults)}")
            for fault in faults:
                print(f"    {fault}")
            for row in outcome.output.splitlines()[-8:]:
                print(f"    | {row}", flush=True)

    def _as_run(self, piece: Piece) -> str:
        """Return the text to run; a command that runs until Ctrl-C gets one after the time of the table."""
        for entry in TABLES["until_ctrl_c"]:
            if piece.kind == "sh" and re.search(entry["command"], piece.text):
                return (
                    f"timeout --preserve-status -s INT {entry['after_s']} bash -c {shlex.quote(piece.text)}"
                )
        return piece.text

    def _faults(self, piece: Piece, outcome: Outcome) -> list[str]:
        expected = [0]
        for entry in TABLES["code"]:
            if re.search(entry["command"], piece.text) and self.name in entry.get("pages", [self.name]):
                expected = entry["codes"]
        faults = []
        if outcome.code not in expected:
            faults.append(f"exit code {outcome.code}, expected {' or '.join(map(str, expected))}")
        return faults + [f"not in the output: {line}" for line in differences(piece.shown, outcome.output)]


def main() -> None:
    """Run the pages, and end with code 1 if a command failed or printed other lines than its page."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("pages", nargs="*", type=Path, metavar="PAGE", help="all pages if left out")
    parser.add_argument("--work", type=Path, help="folder of the clones; a temporary one if left out")
    parser.add_argument("--environment", type=Path, help="folder of an environment with skyherd to use")
    parser.add_argument("--list", action="store_true", help="print what would run, and run nothing")
    options = parser.parse_args()
    pages = [path.resolve() for path in options.pages] or default_pages()
    for page in pages:
        if not page.is_file() or not page.is_relative_to(ROOT):
            raise SystemExit(f"error: {page}: no page of this checkout; give paths such as docs/tutorial.md")
    totals = Totals()
    if options.list:
        for page in pages:
            name = page.relative_to(ROOT).as_posix()
            for piece in pieces_of(page):
                if piece.kind != "toml":
                    print(f"{name:26} {reason_to_skip(name, piece) or 'run'}: {piece.title}")
        return
    with tempfile.TemporaryDirectory() as temporary:
        work = (options.work or Path(temporary)).resolve()
        work.mkdir(parents=True, exist_ok=True)
        environment = (options.environment or make_environment(work)).absolute()
        for page in pages:
            PageRun(page, work, environment, totals).run()
    print(f"\n{totals.ran} ran, {len(totals.wrong)} wrong")
    for line in totals.wrong:
        print(f"  {line}")
    for why, lines in totals.skipped.items():
        print(f"\nskipped, {why}:")
        for line in lines:
            print(f"  {line}")
    raise SystemExit(1 if totals.wrong else 0)


if __name__ == "__main__":
    main()
