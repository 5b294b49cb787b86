"""Workers and temporary files of every verb end with their parent, also when it is killed."""

import os
import re
import signal
import subprocess
import sys
import time
import uuid
from pathlib import Path

import pytest

from skyherd.jobs.lifetime import temporary_folder

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="processes are looked up in /proc")

MARKER = "SKYHERD_TEST_MARKER"
"""Environment variable that identifies the processes of a test."""

PATIENCE_S = 120.0
"""Timeout of the start of a process, s. Chosen."""

END_S = 5.0
"""Timeout of the end of all processes after a kill, s. Chosen: a thousand times the usual time."""

QUIET_S = 1.5
"""Time for which no file may appear afterwards, s. Chosen: longer than a worker takes for an image."""


def marked(marker: str) -> set[int]:
    """Return the processes with a marker in their environment; a zombie has none."""
    found = set()
    for folder in Path("/proc").iterdir():
        if folder.name.isdigit():
            try:
                if f"{MARKER}={marker}".encode() in (folder / "environ").read_bytes().split(b"\0"):
                    found.add(int(folder.name))
            except OSError:
                continue
    return found


def semaphores(pids: set[int]) -> set[str]:
    """Return the named semaphores that processes use."""
    texts = []
    for pid in pids:
        try:
            texts.append(Path(f"/proc/{pid}/maps").read_text())
        except OSError:
            continue
    return set(re.findall(r"/dev/shm/sem\.\S+", "".join(texts)))


def wait_until(holds, seconds: float, what: str) -> None:
    ends_s = time.monotonic() + seconds
    while not holds():
        assert time.monotonic() < ends_s, what
        time.sleep(0.02)


def files(folder: Path) -> dict[str, int]:
    """Return the size of each file below a folder."""
    return {str(path): path.stat().st_size for path in folder.rglob("*") if path.is_file()}


VERBS = {
    "dataset make": (["dataset", "make", "small", "--images", "400"], "images/*/*.png", True),
    "bench detectors": (["bench", "detectors", "--quick", "--detectors", "opencv"], None, True),
    "study": (["study", "noise", "--quick"], "study.json", True),
    "run": (["run", "star", "--no-video"], "run.mcap", False),
}
"""Verbs that start processes: arguments, files that exist once the processes work, and whether the workers
share named semaphores."""


@pytest.mark.slow
@pytest.mark.parametrize("verb", VERBS)
def test_sigkill_of_a_verb_ends_all_its_processes(tmp_path, verb) -> None:
    arguments, written, uses_semaphores = VERBS[verb]
    marker, out, temporary = uuid.uuid4().hex, tmp_path / "out", tmp_path / "temporary"
    temporary.mkdir()
    process = subprocess.Popen(
        [sys.executable, "-m", "skyherd", *arguments, "--jobs", "2", "--out", str(out)],
        env=os.environ | {MARKER: marker, "TMPDIR": str(temporary)},
        stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
    )  # fmt: skip
    try:
        wait_until(lambda: written is None or list(out.glob(written)), PATIENCE_S, "an output")
        wait_until(lambda: len(marked(marker)) >= 3, PATIENCE_S, "the workers")
        if uses_semaphores:
            wait_until(lambda: semaphores(marked(marker)), PATIENCE_S, "the workers' semaphores")
        time.sleep(1.0)
        assert process.poll() is None, "the verb ended before it was killed"
        names = semaphores(marked(marker))
        process.send_signal(signal.SIGKILL)
        process.wait()
        wait_until(lambda: not marked(marker), END_S, "the end of the workers")
        left = files(out)
        time.sleep(QUIET_S)
        assert files(out) == left
        assert not [name for name in names if Path(name).exists()]
        assert not list(temporary.iterdir())
    finally:
        for pid in marked(marker):
            os.kill(pid, signal.SIGKILL)
        process.wait()


POOL = """
import sys, time
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from skyherd.jobs.lifetime import start_worker

if __name__ == "__main__":
    with ProcessPoolExecutor(2, mp_context=get_context("spawn"), initializer=start_worker) as pool:
        running = [pool.submit(time.sleep, 600) for _ in range(4)]
        time.sleep(600)
"""


@pytest.mark.parametrize("initializer", ["start_worker", "None"])
def test_pool_workers_end_with_their_killed_parent(tmp_path, initializer) -> None:
    """Negative control: without the initializer the workers stay."""
    program, marker = tmp_path / "pool.py", uuid.uuid4().hex
    program.write_text(POOL.replace("initializer=start_worker", f"initializer={initializer}"))
    process = subprocess.Popen(
        [sys.executable, str(program)], env=os.environ | {MARKER: marker}, stderr=subprocess.DEVNULL
    )
    try:
        wait_until(lambda: len(marked(marker)) >= 4 and len(semaphores(marked(marker))) > 0, 30, "workers")
        time.sleep(1.0)
        process.kill()
        process.wait()
        if initializer == "None":
            time.sleep(1.0)
            assert len(marked(marker)) >= 3
        else:
            wait_until(lambda: not marked(marker), END_S, "the end of the workers")
    finally:
        for pid in marked(marker):
            os.kill(pid, signal.SIGKILL)
        process.wait()


FOLDER = """
import sys, time
from skyherd.jobs.lifetime import temporary_folder

with temporary_folder("skyherd-test-") as folder:
    (folder / "below").mkdir()
    (folder / "below" / "file").write_text("x")
    print(folder, flush=True)
    time.sleep(600)
"""


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGTERM])
def test_temporary_folder_of_a_killed_process_is_removed(tmp_path, number) -> None:
    process = subprocess.Popen(
        [sys.executable, "-c", FOLDER],
        env=os.environ | {"TMPDIR": str(tmp_path)}, stdout=subprocess.PIPE, text=True,
    )  # fmt: skip
    folder = Path(process.stdout.readline().strip())
    assert (folder / "below" / "file").exists() and folder.parent == tmp_path
    process.send_signal(number)
    process.communicate()
    wait_until(lambda: not folder.exists(), END_S, "the folder is there")


def test_temporary_folder_is_removed_after_an_error(tmp_path, monkeypatch) -> None:
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    with pytest.raises(KeyError), temporary_folder("skyherd-test-") as folder:
        (folder / "file").write_text("x")
        raise KeyError
    assert not list(tmp_path.iterdir())


WATCHER = """
import time
from multiprocessing import get_context
from skyherd.jobs import lifetime

def work():
    lifetime._signal_at_parents_end = lambda: False  # as elsewhere than on Linux
    lifetime.end_with_parent()
    time.sleep(600)

if __name__ == "__main__":
    process = get_context("spawn").Process(target=work)
    process.start()
    time.sleep(600)
"""


def test_process_without_the_signal_ends_by_its_pipe(tmp_path) -> None:
    program, marker = tmp_path / "watcher.py", uuid.uuid4().hex
    program.write_text(WATCHER)
    process = subprocess.Popen([sys.executable, str(program)], env=os.environ | {MARKER: marker})
    try:
        wait_until(lambda: len(marked(marker)) >= 3, 30, "the processes")
        time.sleep(1.0)
        process.kill()
        process.wait()
        wait_until(lambda: not marked(marker), END_S, "the end of the worker")
    finally:
        for pid in marked(marker):
            os.kill(pid, signal.SIGKILL)
        process.wait()
