"""Compare the recorded messages of two versions of skyherd, scenario by scenario and topic by topic.

    python benchmarks/same_messages.py --against $(git merge-base main HEAD) [--duration 20]
    python benchmarks/same_messages.py star tree --against HEAD~3 --perception noisy

Each scenario runs in both versions with the same seed and the same packages. Every message of the two files
`run.mcap` is compared byte by byte: number of messages, times and bodies of each topic. Exit code 0 if all
are equal, 1 if any differs.

A version is unpacked from git into a temporary folder. This version is the working tree, with changes that
are not committed.
"""

import argparse
import os
import subprocess
import sys
import tempfile
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path
from time import perf_counter

from mcap.reader import make_reader
from versions import link_packages, unpacked

from skyherd.cli.console import complain
from skyherd.errors import SkyherdError

ROOT = Path(__file__).parents[1]

SCENARIOS = ("star", "tree", "crowd", "handheld")
"""Scenarios that are compared by default. *Chosen*: flat and tilted cameras, few and many units, bodies."""

RUN = """
import os, sys
from pathlib import Path
import skyherd.control
if not Path(skyherd.control.__file__).is_relative_to(os.environ["PYTHONPATH"]):
    sys.exit(f"imported {skyherd.control.__file__}, not from {os.environ['PYTHONPATH']}")
from skyherd.datasets import load_mission
from skyherd.loop import run_steps
from skyherd.recording.writer import McapRecorder
name, path, *settings = sys.argv[1:]
mission = load_mission(name, settings)
with McapRecorder(Path(path), mission) as recorder:
    for step in run_steps(mission):
        recorder.write(step)
    recorder.finish(step.time_s, 0.0)
"""
"""Record a run without its video and figures. It uses only what all compared versions have."""


@dataclass(frozen=True)
class Topic:
    """The messages of one topic of a recording.

    Attributes:
        count: number of messages.
        digests: a digest of the time and the body of each, in order.
    """

    count: int
    digests: tuple[str, ...]

    def first_difference(self, other: "Topic") -> int | None:
        """Return the number of the first message that differs, or None if all are equal."""
        if self == other:
            return None
        pairs = zip(self.digests, other.digests, strict=False)
        return next((row for row, (one, two) in enumerate(pairs) if one != two), min(self.count, other.count))


def read_topics(path: Path) -> dict[str, Topic]:
    """Return the topics of a recording by name."""
    digests: dict[str, list[str]] = defaultdict(list)
    with path.open("rb") as stream:
        for _, channel, message in make_reader(stream).iter_messages(log_time_order=False):
            body = message.log_time.to_bytes(8, "little") + message.data
            digests[channel.topic].append(sha256(body).hexdigest())
    return {topic: Topic(len(found), tuple(found)) for topic, found in digests.items()}


def differences(this: dict[str, Topic], other: dict[str, Topic]) -> list[str]:
    """Return one line for each topic whose messages are not the same in both recordings."""
    none = Topic(0, ())
    lines = []
    for name in sorted(this.keys() | other.keys()):
        one, two = this.get(name, none), other.get(name, none)
        row = one.first_difference(two)
        if row is not None:
            lines.append(f"{name}: {one.count} and {two.count} messages, the first that differs is {row}")
    return lines


def record(version: Path, scenario: str, path: Path, settings: Sequence[str]) -> float:
    """Record a run of one version into a file, and return the wall time, s."""
    threads = dict.fromkeys(("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"), "1")
    started_s = perf_counter()
    subprocess.run(
        [sys.executable, "-c", RUN, scenario, str(path), *settings],
        check=True,
        cwd=path.parent,
        env=os.environ | threads | {"PYTHONPATH": str(version)},
    )
    return perf_counter() - started_s


def compare(versions: Sequence[Path], scenario: str, settings: Sequence[str], work: Path) -> bool:
    """Run a scenario in both versions, print how they compare, and return whether they are equal."""
    topics, walls_s = [], []
    for number, version in enumerate(versions):
        path = work / f"{scenario}-{number}.mcap"
        walls_s.append(record(version, scenario, path, settings))
        topics.append(read_topics(path))
    lines = differences(topics[0], topics[1])
    count = sum(topic.count for topic in topics[0].values())
    verdict = "DIFFERENT" if lines else "equal"
    walls = " and ".join(f"{wall_s:.0f} s" for wall_s in walls_s)
    print(f"{scenario}: {verdict}, {len(topics[0])} topics, {count} messages, {walls}", flush=True)
    for line in lines:
        print(f"  {line}", flush=True)
    return not lines


def main() -> int:
    """Compare the scenarios that are named, and return the exit code."""
    parser = argparse.ArgumentParser(description="Compare the recorded messages of two versions of skyherd.")
    parser.add_argument("scenarios", nargs="*", default=SCENARIOS)
    parser.add_argument("--against", required=True, help="a commit, branch or tag")
    parser.add_argument("--duration", type=float, default=20.0, help="simulated time of each run, s")
    parser.add_argument("--perception", help="rendered, ideal or noisy; as in the scenario if left out")
    parser.add_argument("--set", action="append", default=[], help="key=value put over the scenario")
    options = parser.parse_args()
    settings = [f"duration_s={options.duration}", *options.set]
    settings += [f"perception={options.perception}"] if options.perception else []
    try:
        with (
            tempfile.TemporaryDirectory(prefix="skyherd-") as name,
            unpacked(options.against, ROOT) as other,
        ):
            work = Path(name)
            link_packages(ROOT, work / "this")
            versions = [work / "this", other]
            return 0 if all([compare(versions, one, settings, work) for one in options.scenarios]) else 1
    except SkyherdError as error:
        complain(str(error))
        return error.exit_code
    except subprocess.CalledProcessError:
        complain("a run failed; its last lines are above")
        return 2


if __name__ == "__main__":
    sys.exit(main())
