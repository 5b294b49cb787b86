"""Wrong arguments of any verb: one line with the option, what is wrong, and what is allowed."""

import pytest
from command_line import assert_refused, call, verbs

PARAMETERS = [(words, command, one) for words, command in verbs() for one in command.params]

NUMBERS = [
    (words, one.opts[0])
    for words, command, one in PARAMETERS
    if one.param_type_name == "option" and one.metavar in ("N", "M", "S", "SECONDS", "X", "FACTOR", "ID")
]


def with_arguments(words, option, value):
    """Return the words of a call in which only the value of one option is wrong."""
    return [*words, f"{option}={value}"]


@pytest.mark.parametrize(("words", "option"), NUMBERS, ids=lambda value: "".join(value))
def test_text_instead_of_a_number_names_option_and_example(words, option, capsys):
    code, out, err = call(capsys, *with_arguments(words, option, "8cm"))
    assert (code, out, err.count("\n")) == (2, "", 1)
    assert err.startswith(f"error: {option}: '8cm' is not a ")
    assert ", such as " in err and "valid" not in err


@pytest.mark.parametrize(("words", "option"), NUMBERS, ids=lambda value: "".join(value))
def test_example_of_an_error_is_accepted(words, option, capsys):
    example = call(capsys, *with_arguments(words, option, "8cm"))[2].strip().rpartition("such as ")[2]
    _, _, err = call(capsys, *with_arguments(words, option, example), "--no-such-option")
    assert err.startswith("error: --no-such-option: no option of ")


@pytest.mark.parametrize(
    ("words", "parameter"),
    [(words, one) for words, _, one in PARAMETERS if one.required],
    ids=lambda value: value.name if hasattr(value, "name") else " ".join(value),
)
def test_required_parameters_show_an_example(words, parameter):
    assert "such as " in parameter.help, (words, parameter.name)


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (
            "detect x.png --marker-side-m 8cm",
            "--marker-side-m: '8cm' is not a number; a number of metres, such as 0.12",
        ),
        ("run star --seed 1.5", "--seed: '1.5' is not a whole number; a whole number, such as 2"),
        ("run star --jobs 0", "--jobs: 0 is too small; a whole number from 1, such as 2"),
        ("play --port 99999", "--port: 99999 is too large; a whole number from 0 to 65535, such as 8440"),
        ("play --speed nan", "--speed: nan is not a number; a number from 0.01 to 100, such as 1"),
        (
            "live arm webcams --robot 3 --robot x",
            "--robot: 'x' is not a whole number; a whole number, such as 2",
        ),
        ("unit webcams zero", "UNIT: 'zero' is not a whole number; a whole number from 0, such as 2"),
        (
            "run star --perception rendred",
            "--perception: 'rendred'; did you mean 'rendered'? one of rendered, ideal, noisy",
        ),
        ("detect x.png --format json", "--format: 'json'; did you mean 'jsonl'? one of csv, jsonl"),
        (
            "run star --jobbs 2",
            "--jobbs: no option of `skyherd run`; did you mean '--jobs'? see `skyherd run --help`",
        ),
        (
            "live stop webcams -x",
            "-x: no option of `skyherd live stop`; one of --set, --insecure, --help; "
            "see `skyherd live stop --help`",
        ),
        ("run star --jobs", "--jobs: its value is missing; a whole number from 1, such as 2"),
        (
            "study noise --scheduler",
            "--scheduler: its value is missing; write `--scheduler tcp://HOST:PORT`; "
            "see `skyherd study --help`",
        ),
        ("run star --no-video=3", "--no-video: takes no value; --no-video alone"),
        (
            "run",
            "SCENARIO: missing; a built-in scenario, such as star, or a TOML file; see `skyherd run --help`",
        ),
        (
            "markers --ids 0-3",
            "--side: missing; side of the black square, such as 0.12m, 12cm or 120mm; "
            "see `skyherd markers --help`",
        ),
        (
            "run star extra",
            "skyherd run: 'extra' is one argument too many; it takes SCENARIO; "
            "put a name with spaces into quotes",
        ),
        (
            "bench detector",
            "skyherd bench: no verb 'detector'; did you mean 'detectors'? "
            "one of detectors, photographs, boards",
        ),
        ("bench", "skyherd bench: its verb is missing; one of detectors, photographs, boards"),
        ("--vrsion", "--vrsion: no option of `skyherd`; did you mean '--version'? see `skyherd --help`"),
    ],
)
def test_wrong_argument_is_one_clear_line(arguments, said, capsys):
    refused = call(capsys, *arguments.split())
    assert_refused(refused)
    assert refused[2] == f"error: {said}\n"


def test_misspelt_verb_gets_the_nearest_name(capsys):
    assert_refused(call(capsys, "rn", "star"), "skyherd: no verb 'rn'; did you mean 'run'? one of run, play")
    assert_refused(call(capsys, "live", "strat"), "skyherd live: no verb 'strat'; ", "one of show, ")
