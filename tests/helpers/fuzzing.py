"""Shared parts of the fuzz tests: randomly damaged inputs, and invariants of the command line.

Each check has a fast test with few fixed examples, and a slow test (`-m slow`) with many random ones.
`SKYHERD_FUZZ_EXAMPLES` multiplies the number of the latter.
"""

import contextlib
import copy
import hashlib
import io
import json
import os
import re
import signal
import tempfile
import time
import warnings
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from skyherd.cli import main
from skyherd.errors import MAX_PROBLEMS, InputError, SkyherdError

MAX_CHARACTERS = 500
"""Maximum length of a line of a refusal, characters."""

MAX_LINES = MAX_PROBLEMS + 1
"""Maximum number of lines of a refusal: one per problem, and one that counts the rest."""

LATEST_S = 5.0
"""Maximum processor time of a refusal, s. Unlike wall time it does not depend on the load of the machine."""

FOR_EVER_S = 900.0
"""Wall time after which a call counts as blocked for ever, such as by reading a pipe, s."""

MANY = 200 * int(os.environ.get("SKYHERD_FUZZ_EXAMPLES", "1"))
"""Number of examples of each slow test."""

NASTY_VALUES = (
    "0", "-1", "1e308", "-1e308", "1e-320", "1e-9", "nan", "inf", "-inf", "9223372036854775808", "1e999",
    "9" * 400, "9" * 5000, "true", '""', '"a"', '"\\u0000"', '"../../x"', "[]", "[[]]", "{}", "[1]",
    "[nan, nan]", "[1e308, -1e308]", "[1, 2, 3]", '"' + "x" * 3000 + '"', "1979-05-27", "0.5", "1", "2", "3",
    "1000000",
)  # fmt: skip
"""TOML values that are invalid or extreme for some keys."""

SETTABLE = (
    "seed", "duration_s", "step_s", "control.k", "control.b_th", "units.0.yaw_deg", "units.*.height_m",
    "units.0.frame_rate_hz", "units.0.camera.size_px", "units.0.camera.half_angle_deg", "marker.side_m",
    "marker.dictionary", "robots.timeout_s", "robots.scatter", "network.frame_loss", "template.shape", "name",
    "selection.kind", "ground.kind", "ground.image", "template.image", "detector", "units.9", "a.b.c",
    "units.-1",
)  # fmt: skip
"""Keys of a scenario, and some invalid ones."""

FOREIGN_TEXTS = ("\udcff", '"\udcff"', "\ud800", '"a\udc80b"', "['\udcff']", "{ a = '\udcff' }")
"""Texts that are not UTF-8, as decoded from the command line, and as values of TOML."""

OTHER_TYPES = (
    None, True, 0, -1, 1e308, "", "x", "\ud800", "\udcff", [], [[]], [1], ["x"], {}, {"x": 1}, [{}], 10**400,
    {"preset": [1]}, [None], float("nan"),
)  # fmt: skip
"""Values of JSON and Python, most of an unexpected type."""

DEPTHS = (10, 70, 900, 5000, 100_000)
"""Nesting depths of lists and objects: few, too many, and more than the interpreter's stack allows."""

TREE_DEPTHS = (10, 70, 300)
"""Nesting depths of JSON that a test itself decodes."""

NUMBER = re.compile(rb"(?<== )[^\n]+|-?\d+(\.\d+)?")
"""Pattern of a value of a TOML file, or of a number in a list."""


@st.composite
def damaged(draw: Any, data: bytes) -> bytes:
    """Draw a file's bytes with bits flipped, and parts cut out, repeated, exchanged or inserted."""
    for _ in range(draw(st.integers(1, 4))):
        at = int(draw(st.floats(0, 1, exclude_max=True)) * max(len(data), 1))
        length = draw(st.integers(1, 80))
        head, middle, tail = data[:at], data[at : at + length], data[at + length :]
        match draw(st.sampled_from(["flip", "cut", "end", "repeat", "insert", "move"])):
            case "flip":
                data = head + bytes([(middle or b"x")[0] ^ (1 << draw(st.integers(0, 7)))]) + data[at + 1 :]
            case "cut":
                data = head + tail
            case "end":
                data = head
            case "repeat":
                data = head + middle * draw(st.integers(2, 50)) + tail
            case "insert":
                data = head + draw(st.binary(max_size=20)) + data[at:]
            case "move":
                data = tail + middle + head
    return data


@st.composite
def nonsense(draw: Any, text: bytes) -> bytes:
    """Draw a TOML file with some values replaced by invalid ones, and some lines removed or repeated."""
    for _ in range(draw(st.integers(1, 3))):
        values = list(NUMBER.finditer(text))
        if values:
            found = values[draw(st.integers(0, len(values) - 1))]
            text = text[: found.start()] + draw(st.sampled_from(NASTY_VALUES)).encode() + text[found.end() :]
        if draw(st.integers(0, 4)) == 0:
            lines = text.splitlines(keepends=True)
            k = draw(st.integers(0, len(lines) - 1))
            text = b"".join(lines[:k] + lines[k : k + 1] * draw(st.sampled_from([0, 2])) + lines[k + 1 :])
    return text


def nested(levels: int, kind: str = "[") -> str:
    """Return a JSON text with a nesting depth; kinds `[...` and `{...` leave it unclosed."""
    begin = "[" if kind[0] == "[" else '{"a":'
    return begin * levels + ("" if kind.endswith("...") else "1" + {"[": "]", "{": "}"}[kind[0]] * levels)


@st.composite
def other_values(draw: Any, data: bytes, depths: Sequence[int] = DEPTHS) -> bytes:
    """Draw a JSON file with the values of one to three keys replaced, mostly by another type."""
    document = json.loads(data)
    deep: dict[str, str] = {}
    for number in range(draw(st.integers(1, 3))):
        node, key = document, None
        places = []
        while isinstance(node, dict | list) and node:
            keys = sorted(node) if isinstance(node, dict) else range(len(node))
            key = draw(st.sampled_from(keys))
            places.append((node, key))
            node = node[key]
        if not places:
            break
        node, key = draw(st.sampled_from(places))
        node[key] = copy.deepcopy(draw(st.sampled_from([*OTHER_TYPES, "deep"])))
        if node[key] == "deep":
            node[key] = f"deep {number}"
            deep[f'"deep {number}"'] = nested(draw(st.sampled_from(depths)), draw(st.sampled_from("[{")))
    text = json.dumps(document)
    for mark, value in deep.items():
        text = text.replace(mark, value)
    return text.encode()


def deep_json() -> st.SearchStrategy[bytes]:
    """Return a strategy of JSON texts that consist of nesting only."""
    kinds = st.sampled_from(["[", "{", "[...", "{..."])
    return st.builds(nested, st.sampled_from(DEPTHS), kinds).map(str.encode)


def fuzzed(
    fast: int, slow: int = MANY, **strategies: Any
) -> Callable[[Callable[..., None]], tuple[Any, Any]]:
    """Return a decorator that makes two tests of a check: a fast fixed one, and a slow random one."""

    def make(check: Callable[..., None]) -> tuple[Any, Any]:
        quiet = [HealthCheck.too_slow, HealthCheck.data_too_large, HealthCheck.filter_too_much]
        short = settings(max_examples=fast, suppress_health_check=quiet, derandomize=True)
        long = settings(
            max_examples=slow, suppress_health_check=quiet, derandomize=False, print_blob=True, database=None
        )
        return (
            short(given(**strategies)(_copy(check))),
            pytest.mark.slow(long(given(**strategies)(_copy(check)))),
        )

    return make


def _copy(check: Callable[..., None]) -> Callable[..., None]:
    def test(**drawn: Any) -> None:
        check(**drawn)

    test.__doc__ = check.__doc__
    return test


@contextlib.contextmanager
def playground() -> Iterator[Path]:
    """Provide a new working folder with a file of the user."""
    before = Path.cwd()
    with tempfile.TemporaryDirectory(prefix="skyherd-fuzz-") as name:
        os.chdir(name)
        try:
            Path("mine.txt").write_text("precious")
            yield Path(name)
        finally:
            os.chdir(before)


def contents(folder: Path) -> dict[str, str]:
    """Return the SHA-256 of each file below a folder, and an entry for each folder."""
    return {
        str(path.relative_to(folder)): hashlib.sha256(path.read_bytes()).hexdigest() if path.is_file() else ""
        for path in folder.rglob("*")
    }


@contextlib.contextmanager
def not_for_ever() -> Iterator[None]:
    """Fail if the body takes longer than `FOR_EVER_S`."""

    def fail(*_: Any) -> None:
        raise AssertionError(f"not done after {FOR_EVER_S:g} s")

    before = signal.signal(signal.SIGALRM, fail)
    signal.setitimer(signal.ITIMER_REAL, FOR_EVER_S)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, before)


def refusal(call: Callable[[], object]) -> SkyherdError | None:
    """Call a function and return its refusal, or None. Check that a refusal is short and fast."""
    began_s = time.process_time()
    try:
        with not_for_ever():
            call()
    except SkyherdError as error:
        assert time.process_time() - began_s < LATEST_S, error
        lines = error.lines if isinstance(error, InputError) else (str(error),)
        assert len(lines) <= MAX_LINES, error
        assert all(len(line) < MAX_CHARACTERS and "\n" not in line for line in lines), error
        return error
    return None


def run(*arguments: Any) -> tuple[int, str]:
    """Return exit code and stderr of one call of the command line in this process; warnings are errors."""
    out, err = io.StringIO(), io.StringIO()
    with (
        contextlib.redirect_stdout(out),
        contextlib.redirect_stderr(err),
        warnings.catch_warnings(),
        not_for_ever(),
    ):
        warnings.simplefilter("ignore", DeprecationWarning)
        try:
            main([str(argument) for argument in arguments])
        except SystemExit as ended:
            return int(ended.code or 0), err.getvalue()
    raise AssertionError("the command line did not end")


def assert_well_behaved(folder: Path, *arguments: Any) -> int:
    """Call the command line, check its invariants for any input, and return the exit code.

    The exit code is 0, 1 or 2, without a traceback. Existing files are unchanged. A refusal has at most
    `MAX_LINES` short lines, is fast, and leaves no new file.
    """
    before = contents(folder)
    began_s = time.process_time()
    code, err = run(*arguments)
    took_s = time.process_time() - began_s
    after = contents(folder)
    assert code in (0, 1, 2), (arguments, code, err)
    assert "Traceback" not in err
    lines = err.splitlines()
    assert all(len(line) < MAX_CHARACTERS for line in lines), lines
    assert all(line.startswith(("error: ", "warning: ")) for line in lines), lines
    changed = [name for name in before if after.get(name) != before[name]]
    assert not changed, (arguments, changed)
    if code == 2:
        assert took_s < LATEST_S, (arguments, took_s, lines)
        assert 1 <= sum(line.startswith("error: ") for line in lines) <= MAX_LINES, lines
        assert after == before, (arguments, sorted(after.keys() - before.keys()))
    return code
