"""Make consumer.png: the scenarios star and handheld, beside themselves through consumer cameras.

python docs/scripts/make_consumer_figure.py            # writes docs/consumer.png
"""

from pathlib import Path

import cv2
import numpy as np

from skyherd.datasets import load_mission
from skyherd.drawing.canvas import draw_text
from skyherd.drawing.palette import INK, PAPER, rgb
from skyherd.render import Shot
from skyherd.sim.perception import make_renderer
from skyherd.sim.physics import make_world

CROP_PX, TIMES, TITLE_PX, GAP_PX = 110, 4, 26, 10
UNIT, WARM_UP = 0, 3
SCENARIOS = ("star", "star-consumer", "handheld", "handheld-consumer")


def picture(name: str) -> np.ndarray:
    """Return an enlarged crop of a unit's first image around the most central marker."""
    mission = load_mission(name)
    world, renderer = make_world(mission), make_renderer(mission, np.random.default_rng(0))
    camera, pose, markers = world.cameras[UNIT], world.camera_pose(UNIT), world.markers
    team = markers.ids, markers.positions_m, markers.headings_rad
    for _ in range(WARM_UP):
        image = renderer.render(Shot(camera, pose, *team, stream=UNIT))
    centers = renderer.truth(Shot(camera, pose, *team)).centers_px
    middle = (np.array(camera.size_px) - 1) / 2
    u, v = centers[np.linalg.norm(centers - middle, axis=1).argmin()].astype(int) - CROP_PX // 2
    part = image[v : v + CROP_PX, u : u + CROP_PX]
    return cv2.resize(part, None, fx=TIMES, fy=TIMES, interpolation=cv2.INTER_NEAREST)


def main() -> None:
    """Arrange the pictures and write the figure."""
    side = CROP_PX * TIMES
    sheet = np.full((2 * (side + TITLE_PX) + GAP_PX, 2 * side + GAP_PX, 3), rgb(PAPER), dtype=np.uint8)
    for number, name in enumerate(SCENARIOS):
        row, column = divmod(number, 2)
        top, left = row * (side + TITLE_PX + GAP_PX), column * (side + GAP_PX)
        draw_text(sheet, name, (left + 2, top + TITLE_PX / 2), rgb(INK), size_px=16)
        sheet[top + TITLE_PX : top + TITLE_PX + side, left : left + side] = picture(name)[..., None]
    file = Path(__file__).parent.parent / "consumer.png"
    cv2.imwrite(str(file), cv2.cvtColor(sheet, cv2.COLOR_RGB2GRAY), [cv2.IMWRITE_PNG_COMPRESSION, 9])
    print(f"{file}: {file.stat().st_size / 1e3:.0f} kB")


if __name__ == "__main__":
    main()
