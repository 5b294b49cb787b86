"""Meaningless options for each verb: a result or a one-line error."""

from pathlib import Path

import pytest
from fuzzing import assert_well_behaved, fuzzed, playground
from hypothesis import strategies as st

from skyherd.plots import panels

NUMBERS = ("0", "-1", "1", "2", str(2**63), str(2**70), "-" + "9" * 400, "nan", "1e3", "", "x")
WORDS = (
    "", " ", "x", "=cmd()", "[red]", "\x1b[2J", "a\nb", "gpj\u202e", "\udcff", "a\0b", "n" * 3000, "../..",
    ".", "/", "/dev/zero", "/dev/null", "mine.txt", "mine.txt/below", "4X4_50", "photometric", "os:getcwd",
    "os:nothing", "a:b:c", ":", "http://x/", "tls://127.0.0.1:1", "tcp://127.0.0.1:1", "ucx://x", "A4", "csv",
)  # fmt: skip
"""Values of options with texts."""

TEXTS = st.sampled_from(WORDS) | st.text(st.characters(codec=None), max_size=12)
NUMERALS = st.sampled_from(NUMBERS)

VERBS = {
    ("scenario", "check"): ({"": TEXTS, "--set": TEXTS}, ()),
    ("scenario", "show"): ({"": TEXTS}, ()),
    ("run",): (
        {"": TEXTS, "--seed": NUMERALS, "--set": TEXTS, "--perception": TEXTS, "--out": TEXTS},
        ("--force", "--no-video", "--record-images"),
    ),
    ("play",): (
        {"": TEXTS, "--seed": NUMERALS, "--set": TEXTS, "--perception": TEXTS, "--out": TEXTS,
         "--speed": NUMERALS, "--host": TEXTS, "--port": NUMERALS}, ()
    ),
    ("view",): ({"": TEXTS, "--html": TEXTS, "--host": TEXTS, "--port": NUMERALS}, ("--force",)),
    ("report",): ({"": TEXTS}, ()),
    ("export",): ({"": TEXTS, "--format": TEXTS, "--out": TEXTS}, ("--force",)),
    ("topology",): ({"": TEXTS, "--out": TEXTS}, ("--force",)),
    ("detect",): (
        {"": TEXTS, "--dictionary": TEXTS, "--detector": TEXTS, "--out": TEXTS, "--format": TEXTS,
         "--border-bits": NUMERALS, "--marker-side-m": NUMERALS, "--camera": TEXTS},
        ("--explain", "--require", "--force", "--inverted", "--repeats", "--one-plane"),
    ),
    ("markers",): (
        {"--ids": TEXTS, "--side": TEXTS, "--out": TEXTS, "--paper": TEXTS, "--dictionary": TEXTS,
         "--border-bits": NUMERALS},
        ("--force",),
    ),
    ("dataset", "make"): (
        {"": TEXTS, "--out": TEXTS, "--jobs": NUMERALS, "--seed": NUMERALS, "--images": NUMERALS}, ()
    ),
    ("dataset", "check"): ({"": TEXTS, "--sample": NUMERALS}, ()),
    ("dataset", "show"): ({"": TEXTS}, ()),
    ("study",): (
        {"": TEXTS, "--out": TEXTS, "--jobs": NUMERALS}, ("--quick", "--retry", "--dry-run", "--show"),
    ),
    ("bench", "detectors"): (
        {"--detectors": TEXTS, "--dictionary": TEXTS, "--seed": NUMERALS, "--jobs": NUMERALS, "--out": TEXTS,
         "--clutter-images": NUMERALS},
        ("--quick", "--force", "--uncorrected"),
    ),
    ("bench", "photographs"): (
        {"": TEXTS, "--sets": TEXTS, "--detector": TEXTS, "--only": TEXTS, "--out": TEXTS}, ("--force",)
    ),
    ("bench", "boards"): (
        {"": TEXTS, "--sets": TEXTS, "--detector": TEXTS, "--only": TEXTS, "--out": TEXTS}, ("--force",)
    ),
}  # fmt: skip
"""Positional argument (without a name), options with their values, and flags, by verb."""


@pytest.fixture(scope="module", autouse=True)
def few_figures():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(panels, "PANELS", panels.PANELS[:1])
        yield


@st.composite
def command_lines(draw):
    """Draw a verb with an argument and one to three options; required ones are never all valid."""
    verb = draw(st.sampled_from(sorted(VERBS)))
    options, flags = VERBS[verb]
    names = [name for name in options if name]
    chosen = draw(st.lists(st.sampled_from(names), unique=True, max_size=3)) if names else []
    arguments = [part for name in chosen for part in (name, draw(options[name]))]
    arguments += draw(st.lists(st.sampled_from(flags), unique=True)) if flags else []
    return [*verb, *arguments, *(["--", draw(options[""])] if "" in options else [])]


@fuzzed(20, arguments=command_lines())
def verbs(arguments):
    """Check all verbs; benchmarks get an invalid detector, since a valid one would take minutes."""
    if arguments[:2] == ["bench", "detectors"]:
        arguments += ["--detectors", "no-such-detector"]
    with playground() as folder:
        Path("taken").mkdir()
        assert_well_behaved(folder, *arguments)


test_verbs, test_verbs_long = verbs


@fuzzed(3, seed=NUMERALS, out=st.sampled_from(["out", "mine.txt", ".", "a/b/c", "a\0b", "\udcff", "n" * 300]))
def runs(seed, out):
    """Check whole runs of a tenth of a second."""
    short = ["--perception", "ideal", "--no-video", "--set", "duration_s=0.1"]
    with playground() as folder:
        assert_well_behaved(folder, "run", "triangle", "--seed", seed, "--out", out, *short)


test_runs, test_runs_long = runs


IDS = st.sampled_from(["0", "0-49", "0-99999999999", "5-1", "0,0", "-1", "9" * 5000])
SIDES = st.sampled_from(["3cm", "1e-320m", "1e308m", "nanm", "infmm", "-3cm", "0.001mm", "9" * 400 + "m"])


@fuzzed(6, ids=TEXTS | IDS, side=TEXTS | SIDES)
def sheets(ids, side):
    with playground() as folder:
        assert_well_behaved(folder, "markers", "--ids", ids, "--side", side, "--out", "a.pdf")


test_sheets, test_sheets_long = sheets
