"""A study from start to finish: plan, missing runs, table, pages.

- `spec.py` reads the file.
- `plan.py` lists the runs and their keys.
- `cluster.py` distributes them to processes through Dask.
- `measure.py` makes a run without any file.
- `store.py` keeps the outcomes in Parquet files that are complete or absent.
- `table.py` joins them into one table.
- A function from table to files draws the pages (`PAGES`).

The key of a run is the hash of its mission. Resuming, changing and repeating a study are therefore one
question: is the key in the store?

A new kind of pages needs an entry in `PAGES`, its name in `skyherd.study.spec.StudySpec.pages`, and, to be
built in, a TOML file in `study/specs/`.

The folder receives `study.json`, `parts/` (every outcome so far), `table.parquet` (one row per run of the
current study), and the pages.
"""

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from time import monotonic
from typing import NamedTuple

import pyarrow as pa

from skyherd.jobs.progress import NO_PROGRESS, Progress
from skyherd.study.cluster import open_client, run_missions
from skyherd.study.figures import figure_names, write_figure_pages
from skyherd.study.invariance.page import invariance_names, write_invariance
from skyherd.study.methods.page import methods_names, write_methods
from skyherd.study.plan import Plan, Run
from skyherd.study.spec import CURVE, Study
from skyherd.study.store import ERROR, Store, check_store, open_store, write_parquet
from skyherd.study.table import TABLE, make_table
from skyherd.version import __version__


class Pages(NamedTuple):
    """Outputs made from a study's table.

    Attributes:
        names: a function of the study: the possible outputs of `write`, relative to the study's folder.
        write: a function of the study, its table and its folder. It writes files and returns the paths for
            viewing, the main one first. It raises OutputError where a file cannot be written.
    """

    names: Callable[[Study], list[str]]
    write: Callable[[Study, pa.Table, Path], list[Path]]


PAGES: Mapping[str, Pages] = {
    "figures": Pages(figure_names, write_figure_pages),
    "invariance": Pages(invariance_names, write_invariance),
    "methods": Pages(methods_names, write_methods),
}
"""Pages of studies, by the name in a study's `pages`."""


@dataclass(frozen=True)
class StudyReport:
    """Result of a study.

    Attributes:
        table: the file with one row per run.
        pages: the files made from it, the main one first.
        runs: number of runs of the study.
        failed: number of runs that ended with an error.
        reused: number of different runs whose outcome was already in the folder.
        made: number of new runs.
        elapsed_s: wall time of the new runs.
    """

    table: Path
    pages: list[Path]
    runs: int
    failed: int
    reused: int
    made: int
    elapsed_s: float


def conduct(
    plan: Plan,
    folder: Path,
    progress: Progress = NO_PROGRESS,
    *,
    scheduler: str | None = None,
    jobs: int | None = None,
    retry: bool = False,
) -> StudyReport:
    """Make all runs of a study that its folder lacks, then its table and pages.

    Outcomes are written as they arrive, so that an interrupted or killed study resumes from there.

    Args:
        plan: the study and its runs.
        folder: a new folder, or that of a study.
        progress: receives the number of finished runs.
        scheduler: address of a Dask scheduler to run on; local processes if None.
        jobs: number of local processes; one per core if None.
        retry: repeat failed runs.

    Raises:
        InputError: the folder holds something else, or the scheduler is not usable.
        OutputError: writing failed, or the cluster is gone.
    """
    pages = PAGES[plan.study.spec.pages]
    with open_store(folder, study_mark(plan.study), _names(plan)) as store:
        missing = missing_runs(plan, store, retry=retry)
        reused = len({run.key for run in plan.runs}) - len(missing)
        state = f"{reused} were there" if reused else "starting …"
        progress.update(plan.study.name, 0, len(missing), state)
        began_s = monotonic()
        if missing:
            _make_runs(plan, missing, store, progress, scheduler, jobs)
        elapsed_s = monotonic() - began_s
        table = make_table(plan, store.read())
        path = write_parquet(table, folder / TABLE)
        store.compact()
        return StudyReport(
            table=path,
            pages=pages.write(plan.study, table, folder),
            runs=table.num_rows,
            failed=table.num_rows - table[ERROR].null_count,
            reused=reused,
            made=len(missing),
            elapsed_s=elapsed_s,
        )


def preview(plan: Plan, folder: Path, *, retry: bool = False) -> dict[str, Run]:
    """Return the runs that `conduct` would make in a folder, by key; change nothing.

    Raises:
        InputError: as `conduct` does about the folder.
    """
    check_store(folder, _names(plan))
    return missing_runs(plan, Store(folder), retry=retry)


def _names(plan: Plan) -> list[str]:
    """Return the files of a study in its folder beside the store's."""
    return [TABLE, *PAGES[plan.study.spec.pages].names(plan.study)]


def _make_runs(
    plan: Plan,
    missing: Mapping[str, Run],
    store: Store,
    progress: Progress,
    scheduler: str | None,
    jobs: int | None,
) -> None:
    """Make runs and store their outcomes as they arrive."""
    began_s, made, failed = monotonic(), 0, 0
    missions = ((key, plan.mission(run)) for key, run in missing.items())
    with open_client(scheduler, jobs) as client:
        for outcomes in run_missions(client, missions, plan.study.spec.curves):
            store.append(outcomes)
            made += len(outcomes)
            failed += sum(outcome["error"] is not None for outcome in outcomes)
            rate = f"{runs_per_s(made, monotonic() - began_s):.3g} runs/s"
            state = f"{rate}, {failed} failed" if failed else rate
            progress.update(plan.study.name, made, len(missing), state)


def runs_per_s(runs: int, elapsed_s: float) -> float:
    """Return the throughput, 0 if no time has passed."""
    return runs / elapsed_s if elapsed_s > 0 else 0.0


def missing_runs(plan: Plan, store: Store, *, retry: bool = False) -> dict[str, Run]:
    """Return the runs that are not in a store, by key, each once; with `retry`, also failed ones."""
    known = store.keys([CURVE + name for name in plan.study.spec.curves], failed=not retry)
    return {run.key: run for run in plan.runs if run.key not in known}


def study_mark(study: Study) -> str:
    """Return the content of `study.json`: the full study as JSON, and the version of skyherd."""
    spec = study.spec.model_dump(mode="json", exclude_none=True)
    return json.dumps({"skyherd": __version__, "study": study.name, **spec}, indent=2) + "\n"
