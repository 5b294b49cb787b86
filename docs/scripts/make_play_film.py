"""Make the moving picture of the page of `skyherd play`, `docs/play.webp`, in Chromium without a GPU.

The loop stands still while a frame is drawn. Four minutes.
"""

import shutil
from collections.abc import Iterator
from contextlib import closing
from io import BytesIO
from pathlib import Path
from queue import SimpleQueue
from tempfile import TemporaryDirectory
from threading import Thread
from time import sleep

from make_play_picture import GL_ARGS
from PIL import Image
from playwright.sync_api import ViewportSize, sync_playwright

from skyherd.loop import Step
from skyherd.play.page import Page
from skyherd.play.session import Change, End, Session
from skyherd.report.access import Access, bind

SIZE_PX: ViewportSize = {"width": 1000, "height": 600}
DRAWING_S = 2.5
"""Time in which the browser draws a step, s. Chosen: frames show their step."""

FRAMES = 60
FRAME_MS = 150
LAST_MS = 1500
"""Time for which the last frame stands still, ms. Chosen: the film lasts ten seconds."""

FRAME_S = 0.5
"""Simulated time from frame to frame, s. Chosen: the shape is complete at the end."""

QUALITY = 55
"""Quality of WebP. Chosen: the film has less than 1.5 MB, and its text stays legible."""

SCRIPT = {
    7.0: Change(({"kind": "camera", "unit": 0, "zoom": 1.3},)),
    12.0: Change(({"kind": "robot", "robot": 15, "position_m": [8.0, -9.0]},)),
}
"""Requests by simulated time, s."""


class FilmedSession(Session):
    """Session that makes the requests of `SCRIPT`, and waits at each frame until it is taken."""

    due: SimpleQueue[None] = SimpleQueue()
    taken: SimpleQueue[None] = SimpleQueue()

    def steps(self) -> Iterator[Step]:
        """Yield the steps."""
        waiting, frame = dict(SCRIPT), 0
        for step in super().steps():
            for time_s in [time_s for time_s in waiting if time_s <= step.time_s + 1e-9]:
                self.ask(waiting.pop(time_s))
            yield step
            if frame < FRAMES and step.time_s >= frame * FRAME_S - 1e-9:
                frame += 1
                self.due.put(None)
                self.taken.get()


def film(page: Page, session: FilmedSession) -> list[Image.Image]:
    """Return the frames of the page."""
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=shutil.which("chromium"), args=GL_ARGS)
        window = browser.new_page(viewport=SIZE_PX)
        window.goto(page.access.url)
        window.get_by_role("button", name="Pause (P)").wait_for(timeout=120_000)
        window.locator(".mantine-Notification-closeButton").first.click()
        sleep(4 * DRAWING_S)
        frames = []
        for _ in range(FRAMES):
            session.due.get()
            sleep(DRAWING_S)
            frames.append(Image.open(BytesIO(window.screenshot())).convert("RGB"))
            session.taken.put(None)
        return frames


def main() -> None:
    """Run the session, and save the film."""
    with TemporaryDirectory() as folder, bind("127.0.0.1", 0) as listener:
        session = FilmedSession.open("star", folder=Path(folder), speed=None)
        page = Page(session, Access.make("127.0.0.1", listener.getsockname()[1]), listener)
        with closing(page):
            running = Thread(target=page.run)
            running.start()
            try:
                frames = film(page, session)
            finally:
                session.ask(End())
                running.join()
    path = Path(__file__).parent.parent / "play.webp"
    durations = [FRAME_MS] * (FRAMES - 1) + [LAST_MS]
    options = {"quality": QUALITY, "method": 6, "minimize_size": True, "loop": 0}
    frames[0].save(path, save_all=True, append_images=frames[1:], duration=durations, **options)
    print(f"{path}: {path.stat().st_size / 1e6:.2f} MB")


if __name__ == "__main__":
    main()
