"""The page: server, scene and panel of one session.

The session runs in the thread of `Page.run`. Another thread owns scene and panel, and draws the newest step
as often as it may. The loop never waits for it, nor for a browser.
"""

from collections.abc import Iterator
from queue import Empty, SimpleQueue
from socket import socket
from threading import Event, Thread
from time import perf_counter

from skyherd.loop import Step
from skyherd.play.messages import MessageFilter
from skyherd.play.panel import Panel
from skyherd.play.pictures import LiveImages
from skyherd.play.scene import Scene
from skyherd.play.server import start_server, stop_server
from skyherd.play.session import End, Session
from skyherd.report.access import Access

DRAWING_SHARE = 0.2
"""Share of its time for which the drawing thread works. Chosen: the loop keeps 0.8 of its rate on two cores
(`benchmarks/play.py`)."""

MIN_INTERVAL_S = 1 / 30
"""Shortest time between two drawings, s. Chosen: smooth to the eye."""

END = object()
"""Last item of the news: the drawing thread ends."""


class Page:
    """A page on which a session is shown and steered.

    Attributes:
        session: the session. `run` iterates its steps.
        access: rules for connections, with the page's address.
        server: viser's server.

    Args:
        session: as the attribute.
        access: as the attribute.
        listener: bound socket of the server.
    """

    def __init__(self, session: Session, access: Access, listener: socket) -> None:
        self.session, self.access = session, access
        self._news: SimpleQueue[Step | str | object] = SimpleQueue()
        self._is_over = Event()
        self._error: BaseException | None = None
        allowed = MessageFilter()
        self.server = start_server(access, listener, allowed)
        self._images = LiveImages(session.mission)
        self._scene = Scene(self.server, session.mission)
        self._panel = Panel(self.server, session, allowed, self._images.first)
        self._scene.on_click(self._panel.choose)
        self._step: Step | None = None
        session.listen(self._news.put)

    def run(self) -> None:
        """Run the session until it is asked to end."""
        drawing = Thread(target=self._keep_drawing, name="drawing", daemon=True)
        try:
            drawing.start()
            for step in self.session.steps():
                self._news.put(step)
        finally:
            self._is_over.set()
            self._news.put(END)
            if drawing.is_alive():
                drawing.join()
        if self._error is not None:
            raise self._error

    def close(self) -> None:
        """Close the page and all connections."""
        stop_server(self.server)

    def _keep_drawing(self) -> None:
        """Draw until the end; an error ends the session, and is raised in its thread."""
        try:
            while self._take_news():
                started_s = perf_counter()
                if self._step is not None:
                    mission = self.session.mission
                    images = list(self._images.draw(self._step, mission))
                    self._scene.believer = self._panel.believer
                    self._scene.draw(self._step, mission, images)
                    self._panel.show(self._step, mission, images)
                cost_s = perf_counter() - started_s
                self._is_over.wait(max(MIN_INTERVAL_S - cost_s, cost_s / DRAWING_SHARE - cost_s))
        except BaseException as error:
            self._error = error
            self.session.ask(End())

    def _take_news(self) -> bool:
        """Wait for news and take in all there are; return False at the end."""
        for news in self._waiting(is_patient=not self._images.is_waiting):
            if news is END:
                return False
            if isinstance(news, str):
                self._panel.notice(news)
            elif isinstance(news, Step):
                if self._step is not None and news.time_s <= self._step.time_s:
                    self._images.clear()
                    self._scene.clear()
                    self._panel.clear()
                self._step = news
                self._images.collect(news)
                self._scene.collect(news)
                self._panel.collect(news)
        return True

    def _waiting(self, *, is_patient: bool) -> Iterator[Step | str | object]:
        """Yield the waiting news; if `is_patient`, wait until there are some."""
        try:
            yield self._news.get(block=is_patient)
            while True:
                yield self._news.get_nowait()
        except Empty:
            return
