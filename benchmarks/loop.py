"""Measure how fast the loop is on one core, and how it compares with another version.

    python benchmarks/loop.py [SCENARIO ...] [--duration 20] [--out runs/bench-loop]
    python benchmarks/loop.py --against main --rounds 5 [--whole]

A scenario is a built-in one or a TOML file; star if none is named. It prints tables and leaves `loop.json`.
With `--against`, the other version is run in alternation with this one (`loop_against.py`).
"""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from loop_result import RESULT, measure_loop, tables

from skyherd.cli.console import ProgressReporter, complain, say, say_table
from skyherd.errors import InputError, SkyherdError
from skyherd.files.output_folder import OutputFolder

VERB = "bench loop"
"""Verb by which a folder's record knows what was made here."""


def measure(options: argparse.Namespace) -> None:
    """Measure, print tables and write the result.

    Raises:
        InputError: an option is out of range, or a scenario or version is not there.
    """
    if not 0.5 <= options.duration <= 1e5:
        raise InputError("--duration", f"{options.duration:g}", "from 0.5 to 100000")
    if options.rounds < 1:
        raise InputError("--rounds", str(options.rounds), "1 or more")
    if options.whole and options.against is None:
        raise InputError("--whole", "given without --against", "both or none")
    with OutputFolder(options.out, VERB, [RESULT], force=options.force) as output:
        with ProgressReporter() as progress:
            result = measure_loop(
                options.scenarios or ["star"],
                options.duration,
                against=options.against,
                repository=options.repository,
                rounds=options.rounds,
                whole=options.whole,
                progress=progress,
            )
        result.write(options.out)
        output.keep()
    for table in tables(result):
        say(table.title, bold=True)
        say_table(table.header, table.rows, right_aligned=table.header[1:])
        say(table.note)
    say(f"see {options.out / RESULT}")


def main(arguments: Sequence[str] | None = None) -> int:
    """Read the options, measure, and return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("scenarios", nargs="*", help="built-in scenarios or TOML files; star if left out")
    parser.add_argument("--duration", type=float, default=20.0, help="simulated seconds of each run")
    parser.add_argument("--against", help="commit, branch or tag of another version")
    parser.add_argument("--rounds", type=int, default=3, help="with --against: runs of each version")
    parser.add_argument("--whole", action="store_true", help="with --against: also time `skyherd run`")
    parser.add_argument(
        "--repository", type=Path, default=Path(), help="with --against: a git repository of skyherd"
    )
    parser.add_argument("--out", type=Path, default=Path("runs/bench-loop"), help="folder for results")
    parser.add_argument("--force", action="store_true", help="replace the results of an earlier call")
    try:
        measure(parser.parse_args(arguments))
    except SkyherdError as error:
        complain(str(error))
        return error.exit_code
    except KeyboardInterrupt:
        complain("interrupted; nothing is left of it")
        return 130
    return 0


if __name__ == "__main__":
    sys.exit(main())
