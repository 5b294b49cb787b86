"""Pages of `skyherd play` for tests."""

import shutil
import threading
from contextlib import closing, contextmanager
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer

import pytest

viser = pytest.importorskip("viser")

from skyherd.play.page import Page  # noqa: E402
from skyherd.play.session import End, Session  # noqa: E402
from skyherd.report.access import Access, bind  # noqa: E402


@contextmanager
def running(page):
    """Run a page in a thread; an error of it is raised at the end."""
    failed = []

    def run():
        try:
            page.run()
        except BaseException as error:
            failed.append(error)

    thread = threading.Thread(target=run)
    thread.start()
    try:
        yield page
    finally:
        page.session.ask(End())
        thread.join(20)
        page.close()
    assert not failed and not thread.is_alive()


@pytest.fixture
def open_page(tmp_path):
    """Return a function that opens a page of a scenario, to be run in a `with` statement."""

    def make(name="star", settings=("perception=ideal",), speed=None):
        session = Session.open(name, settings, folder=tmp_path, speed=speed)
        listener = bind("127.0.0.1", 0)
        access = Access.make("127.0.0.1", listener.getsockname()[1])
        return running(Page(session, access, listener))

    return make


GL_ARGS = ["--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
"""Arguments with which Chromium draws 3-D scenes without a GPU."""


@pytest.fixture(scope="session")
def gl_chromium(browser):
    """Provide Chromium with WebGL; it compiles the shaders of the page once."""
    program = shutil.which("chromium") or shutil.which("google-chrome")
    args = ["--no-sandbox", "--no-first-run", "--disable-background-networking", *GL_ARGS]
    with closing(browser.browser_type.launch(executable_path=program, args=args)) as chromium:
        yield chromium


@pytest.fixture
def gl_browser(gl_chromium):
    """Return a function that opens a page with WebGL in a new context, to be used in a `with` statement."""

    @contextmanager
    def make(url, width=1280, height=800):
        with closing(gl_chromium.new_page(viewport={"width": width, "height": height})) as window:
            window.set_default_timeout(20_000)
            window.goto(url)
            yield window

    return make


class QuietHandler(SimpleHTTPRequestHandler):
    """Handler that logs nothing."""

    def log_message(self, *_):
        pass


@pytest.fixture
def foreign_page(tmp_path):
    """Serve an empty page on another port, and return its address."""
    folder = tmp_path / "foreign"
    folder.mkdir()
    (folder / "index.html").write_text("<!doctype html><title>foreign</title>")
    handler = partial(QuietHandler, directory=str(folder))
    with ThreadingHTTPServer(("127.0.0.1", 0), handler) as server:
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        yield f"http://127.0.0.1:{server.server_port}/"
        server.shutdown()
        thread.join()
