"""Make the picture of the page of `skyherd play`, `docs/play.jpg`, in Chromium without a GPU."""

import shutil
from collections.abc import Iterator
from contextlib import closing
from io import BytesIO
from pathlib import Path
from tempfile import TemporaryDirectory
from threading import Thread
from time import sleep

from PIL import Image
from playwright.sync_api import ViewportSize, sync_playwright

from skyherd.loop import Step
from skyherd.play.page import Page
from skyherd.play.session import Change, End, Pause, Session
from skyherd.report.access import Access, bind

SIZE_PX: ViewportSize = {"width": 1280, "height": 760}
GL_ARGS = ["--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
DRAWING_S = 12.0
"""Time in which the browser draws the last step, s. Chosen: four times as long as it takes."""


SCRIPT = {
    14.0: Change(({"kind": "camera", "unit": 0, "zoom": 1.3},)),
    16.0: Change(({"kind": "robot", "robot": 15, "position_m": [8.0, -9.0]},)),
    22.0: Pause(True),
}
"""Requests by simulated time, s."""


class ScriptedSession(Session):
    """Session that makes the requests of `SCRIPT`."""

    def steps(self) -> Iterator[Step]:
        """Yield the steps, and make each request at its time."""
        waiting = dict(SCRIPT)
        for step in super().steps():
            for time_s in [time_s for time_s in waiting if time_s <= step.time_s + 1e-9]:
                self.ask(waiting.pop(time_s))
            yield step


def picture(page: Page) -> bytes:
    """Return a picture of the page as PNG, after the end of the script."""
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=shutil.which("chromium"), args=GL_ARGS)
        window = browser.new_page(viewport=SIZE_PX)
        window.goto(page.access.url)
        window.get_by_role("button", name="Continue (P)").wait_for(timeout=120_000)
        window.locator(".mantine-Notification-closeButton").first.click()
        sleep(DRAWING_S)
        return window.screenshot()


def main() -> None:
    """Run the session, and save the picture."""
    with TemporaryDirectory() as folder, bind("127.0.0.1", 0) as listener:
        session = ScriptedSession.open("star", folder=Path(folder), speed=None)
        page = Page(session, Access.make("127.0.0.1", listener.getsockname()[1]), listener)
        with closing(page):
            running = Thread(target=page.run)
            running.start()
            try:
                shot = Image.open(BytesIO(picture(page)))
            finally:
                session.ask(End())
                running.join()
    path = Path(__file__).parent.parent / "play.jpg"
    shot.convert("RGB").save(path, quality=85, optimize=True)
    print(f"{path}: {path.stat().st_size / 1e3:.0f} kB")


if __name__ == "__main__":
    main()
