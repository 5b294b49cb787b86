"""A study from start to finish: plan, runs that are not there yet, table, pages.

Left in the folder: `study.json`, `parts/` (every outcome there ever was), `table.parquet` (one row a run of
the study as it is), and the pages.
"""

import json
from pathlib import Path
from typing import NamedTuple, Protocol

from skyherd.study.cluster import open_client, run_missions
from skyherd.study.measure import Outcome
from skyherd.study.pages import write_pages
from skyherd.study.plan import Plan, Run
from skyherd.study.spec import CURVE, Study
from skyherd.study.store import ERROR, Store, open_store, write_parquet
from skyherd.study.table import TABLE, make_table
from skyherd.version import __version__


class Report(NamedTuple):
    """What a study came to: the table's file, the pages, and how many runs there are and failed."""

    table: Path
    pages: list[Path]
    runs: int
    failed: int


class Watcher(Protocol):
    """Told of what goes on."""

    def begin(self, missing: int, there: int) -> None:
        """So many runs are to be made; so many are there already."""

    def advance_runs(self, outcomes: list[Outcome]) -> None:
        """These are made."""


def conduct(
    plan: Plan,
    folder: Path,
    watcher: Watcher,
    *,
    scheduler: str | None = None,
    jobs: int | None = None,
    retry: bool = False,
) -> Report:
    """Make all runs of a study that its folder does not hold, then its table and pages.

    Raises:
        InputError: the folder holds something else, or the scheduler is no good.
        OutputError: something cannot be written, or the cluster is gone.
    """
    with open_store(folder, study_mark(plan.study)) as store:
        missing = missing_runs(plan, store, retry=retry)
        watcher.begin(len(missing), len({run.key for run in plan.runs}) - len(missing))
        if missing:
            with open_client(scheduler, jobs) as client:
                missions = ((key, plan.mission(run)) for key, run in missing.items())
                for outcomes in run_missions(client, missions, plan.study.spec.curves):
                    store.append(outcomes)
                    watcher.advance_runs(outcomes)
        table = make_table(plan, store.read())
        path = write_parquet(table, folder / TABLE)
        store.compact()
        failed = table.num_rows - table[ERROR].null_count
        return Report(path, write_pages(plan.study, table, folder), table.num_rows, failed)


def missing_runs(plan: Plan, store: Store, *, retry: bool = False) -> dict[str, Run]:
    """Runs that are not in a store, by key, each once; with `retry`, those that failed too."""
    known = store.keys([CURVE + name for name in plan.study.spec.curves], failed=not retry)
    return {run.key: run for run in plan.runs if run.key not in known}


def study_mark(study: Study) -> str:
    """What `study.json` says: the study in full, and which skyherd it was."""
    spec = study.spec.model_dump(mode="json", exclude_none=True)
    return json.dumps({"skyherd": __version__, "study": study.name, **spec}, indent=2) + "\n"
