"""`skyherd play`, in process: the printed address, a taken port, a missing library, and the end."""

import http.client
import os
import re
import signal
import subprocess
import sys
import time
from contextlib import closing

import pytest
from command_line import assert_refused, call

from skyherd.report.access import bind

TOKEN_LINE = re.compile(r"open http://127\.0\.0\.1:(\d+)(/\?token=\S+)")
"""The printed address, with its port and its path."""


def test_taken_port_is_one_line(capsys):
    with bind("127.0.0.1", 0) as listener:
        port = listener.getsockname()[1]
        refused = call(capsys, "play", "star", "--port", port)
    assert_refused(refused, f"--port: {port}: ", "another --port")


def test_missing_viser_is_one_line(capsys, monkeypatch):
    monkeypatch.setattr("skyherd.play.extras.find_spec", lambda name: None)
    assert_refused(call(capsys, "play", "star"), "viser is not installed; pip install 'skyherd[play]'")


@pytest.mark.parametrize("host", ["127.0.0.1", "0.0.0.0"])
def test_page_is_served_until_interrupted(tmp_path, host):
    code = "from skyherd.cli import main; main()"
    arguments = ["play", "star", "--port", "0", "--host", host, "--set", "perception=ideal"]
    with subprocess.Popen(
        [sys.executable, "-c", code, *arguments],
        cwd=tmp_path,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env={**os.environ, "PYTHONUNBUFFERED": "1"},
    ) as process:
        try:
            found = TOKEN_LINE.fullmatch(process.stdout.readline().strip())
            with closing(http.client.HTTPConnection("127.0.0.1", int(found[1]), timeout=20)) as connection:
                connection.request("GET", found[2])
                assert connection.getresponse().status == 303
            time.sleep(0.5)
            process.send_signal(signal.SIGINT)
            out, err = process.communicate(timeout=30)
        finally:
            process.kill()
    assert (process.returncode, out) == (130, "")
    lines = err.splitlines()
    assert lines[-1] == "error: interrupted; scenarios that were saved are kept"
    assert len(lines) == (1 if host == "127.0.0.1" else 2)
    assert ("warning" in err) == (host != "127.0.0.1")
    assert list(tmp_path.iterdir()) == []
