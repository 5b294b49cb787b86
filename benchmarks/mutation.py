"""Run mutation tests of safety-critical code: count small changes that no fast test notices.

Parts are the tree protocol, roles, avoidance, flight laws, selection, identities, the fusion of goals, the
reader of recordings, output folders and the live team. Each change alters one comparison, operator, number
or condition, and the part's tests run on it. A change that passes shows a gap in the tests, or has no effect.

    pip install -e '.[test,mutation]'
    python benchmarks/mutation.py --share 0.1            # a tenth of all, drawn from a fixed seed
    python benchmarks/mutation.py --parts roles recording

The changes are made in a copy. Each takes some seconds.
"""

import argparse
import ast
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from random import Random

from cosmic_ray.work_db import WorkDB, use_db
from cosmic_ray.work_item import MutationSpec, TestOutcome

ROOT = Path(__file__).parents[1]
"""The checkout."""

TIMEOUT_S = 180
"""Time after which the tests of a change are ended, s; the change counts as noticed. Chosen: ten times the
longest on an idle core."""


@dataclass(frozen=True)
class Part:
    """Code that is changed, by its place in the package, and the tests that are to notice."""

    code: tuple[str, ...]
    tests: str


PARTS = {
    "tree": Part(
        ("control/tree",),
        "tests/control/tree/test_rules.py tests/control/tree/test_edge.py"
        " tests/control/tree/test_rule_order.py tests/control/topology/test_convergence_rate.py"
        " tests/control/tree/test_protocol.py",
    ),
    "roles": Part(("control/formation/roles.py",), "tests/control/formation/test_roles.py"),
    "avoidance": Part(
        ("control/avoidance",),
        "tests/control/avoidance/test_speed_bound.py tests/control/avoidance/test_retreat.py"
        " tests/control/avoidance",
    ),
    "flight": Part(
        ("control/flight",),
        "tests/control/flight tests/control/topology/test_conditions_and_selection.py",
    ),
    "selection": Part(
        ("control/selection",),
        "tests/control/topology/test_conditions_and_selection.py"
        " tests/datasets/configuration/test_defaults.py tests/control/selection",
    ),
    "identities": Part(("control/identities.py",), "tests/control/test_identities.py"),
    "fusion": Part(("control/robots/goal_fusion.py",), "tests/control/robots"),
    "recording": Part(
        ("recording/survey.py", "recording/reader.py"),
        "tests/recording/test_damages.py tests/recording/test_handmade.py"
        " tests/recording/test_recorders.py tests/recording/test_writer_and_reader.py",
    ),
    "output_folder": Part(("files/output_folder.py",), "tests/files/test_output_folder.py"),
    "driver": Part(("live/drivers/driver.py",), "tests/live/drivers/test_driver.py"),
    "robot_core": Part(
        ("live/robot_core.py",), "tests/live/test_robot_core.py tests/live/test_live_bodies.py"
    ),
    "session": Part(("live/session.py",), "tests/live/test_operator.py tests/live/test_session.py"),
    "operator": Part(("live/operator.py",), "tests/live/test_operator.py"),
    "stop_latch": Part(
        ("live/stop_latch.py",), "tests/live/test_stop_latch.py tests/live/test_stop_model.py"
    ),
    "peers": Part(("live/peers.py",), "tests/live/test_peers.py"),
}
"""The parts, by name."""

NO_CHANGES = ("core/RemoveDecorator",)
"""Kinds of change that are excluded: a class without its decorator fails in every test."""


def copy_package(folder: Path) -> None:
    """Copy package and tests into a folder in the installed layout, so that changes are safe."""
    shutil.copytree(ROOT / "src" / "skyherd", folder / "skyherd")
    for name in ("vision", "control", "render", "datasets"):
        shutil.copytree(ROOT / name, folder / "skyherd" / name)
    for name in ("tests", "benchmarks"):
        shutil.copytree(ROOT / name, folder / name)
    shutil.copy(ROOT / "pyproject.toml", folder)


def annotations(tree: ast.Module) -> Iterator[tuple[int, int, int, int]]:
    """Yield positions of type annotations, (line, column) of begin and end; changes there have no effect."""
    for node in ast.walk(tree):
        kinds = [getattr(node, name, None) for name in ("annotation", "returns")]
        for kind in kinds:
            if isinstance(kind, ast.expr) and kind.end_lineno is not None and kind.end_col_offset is not None:
                yield kind.lineno, kind.col_offset, kind.end_lineno, kind.end_col_offset


def counts(folder: Path, change: MutationSpec) -> bool:
    """Return whether a change can have an effect."""
    if change.operator_name in NO_CHANGES:
        return False
    at = change.start_pos
    spans = annotations(ast.parse((folder / change.module_path).read_text("utf-8")))
    return not any((line, column) <= at <= (last, end) for line, column, last, end in spans)


def run_part(name: str, share: float, seed: int, folder: Path) -> tuple[int, list[MutationSpec]]:
    """Run a share of one part's changes; return how many ran and those that passed unnoticed."""
    part, session = PARTS[name], folder / f"{name}.sqlite"
    files = [
        str(path.relative_to(folder)) for code in part.code for path in sources(folder / "skyherd" / code)
    ]
    config = folder / f"{name}.toml"
    config.write_text(
        f"""[cosmic-ray]
module-path = {files}
timeout = {TIMEOUT_S}
test-command = "{sys.executable} -m pytest -x -q -n 0 -p no:cacheprovider {part.tests}"
[cosmic-ray.distributor]
name = "local"
"""
    )
    cosmic_ray("baseline", config, folder=folder)  # the tests must pass before anything is changed
    cosmic_ray("init", config, session, folder=folder)
    with use_db(session, WorkDB.Mode.open) as db:
        items = [item for item in db.work_items if counts(folder, item.mutations[0])]
        drawn = Random(seed).sample(items, round(share * len(items)))
        db.clear()
        db.add_work_items(drawn)
    cosmic_ray("exec", config, session, folder=folder)
    with use_db(session, WorkDB.Mode.open) as db:
        passed = {job for job, result in db.results if result.test_outcome == TestOutcome.SURVIVED}
    return len(drawn), [item.mutations[0] for item in drawn if item.job_id in passed]


def sources(path: Path) -> list[Path]:
    """Return one file, or the Python files of a folder except those that only gather names."""
    return sorted(set(path.glob("*.py")) - {path / "__init__.py"}) if path.is_dir() else [path]


def cosmic_ray(verb: str, *arguments: Path, folder: Path) -> None:
    """Call cosmic-ray in the copy, in which the tests import the copy's package."""
    command = [sys.executable, "-m", "cosmic_ray.cli", verb, *map(str, arguments)]
    subprocess.run(command, cwd=folder, check=True, env=os.environ | {"PYTHONPATH": str(folder)})


def main() -> None:
    """Print, for each part, how many changes were tried and which were not noticed."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--parts", nargs="*", default=list(PARTS), choices=list(PARTS))
    parser.add_argument("--share", type=float, default=1.0, help="share of all changes that is tried")
    parser.add_argument("--seed", type=int, default=1)
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as made:
        folder = Path(made)
        copy_package(folder)
        tried = noticed = 0
        for name in given.parts:
            count, unnoticed = run_part(name, given.share, given.seed, folder)
            tried, noticed = tried + count, noticed + count - len(unnoticed)
            print(f"{name}: {count - len(unnoticed)} of {count} noticed", flush=True)
            for change in unnoticed:
                line, column = change.start_pos
                how = f"{change.operator_name} {change.operator_args or ''}".strip()
                print(f"  {change.module_path}:{line}:{column} {how}", flush=True)
        print(f"all: {noticed} of {tried} noticed, {100 * noticed / max(tried, 1):.1f} %")


if __name__ == "__main__":
    main()
