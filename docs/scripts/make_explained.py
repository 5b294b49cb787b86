"""Make the picture of `skyherd detect --explain` that the README shows, `docs/explained.jpg`.

A scene with one marker for each common fault is drawn, looked at, and saved with its annotations.
"""

from pathlib import Path

import cv2
import numpy as np
from PIL import Image

from skyherd.inspection import Annotator
from skyherd.markers.dictionary import corners_of_pose, marker_cells
from skyherd.render import Camera, CameraPose, Ground, Renderer, Sensor, Shot
from skyherd.vision import create_detector, explain

DICTIONARY, SIZE_PX = "4X4_50", (960, 600)
FOCAL_PX = 500.0


def draw_markers(
    image: np.ndarray, placed: list[tuple[int, float, float, float, float]], **look: float
) -> np.ndarray:
    """Put markers (id, u, v, heading in degrees, side in px) into the picture, and return it."""
    for marker_id, u, v, heading, side_px in placed:
        renderer = Renderer(DICTIONARY, 1.0, Ground(20), Sensor(0.0, np.random.default_rng(1)), **look)
        pose = CameraPose((0.0, 0.0), FOCAL_PX / side_px)
        place = np.array([[u - (SIZE_PX[0] - 1) / 2, (SIZE_PX[1] - 1) / 2 - v]]) / side_px
        drawn = renderer.render(
            Shot(Camera(SIZE_PX, FOCAL_PX), pose, np.array([marker_id]), place, np.radians([-heading]))
        )
        card = corners_of_pose([[u, v]], np.radians([heading]), [side_px * 1.34])
        mask = cv2.fillPoly(np.zeros(image.shape, np.uint8), [np.rint(card[0]).astype(np.int32)], 255)
        image = np.where(cv2.dilate(mask, np.ones((5, 5))) > 0, drawn, image)
    return image


def make_scene() -> np.ndarray:
    """Return a grey picture of good markers and of one marker per common fault."""
    image = Ground(20).draw(np.array([[20.0, 0, 480], [0, -20, 300], [0, 0, 1]]), SIZE_PX)
    image = draw_markers(image, [(7, 120, 110, 20, 64), (12, 350, 90, -60, 40), (21, 560, 130, 130, 52)])
    image = draw_markers(image, [(3, 150, 300, 70, 8.4)])
    image = draw_markers(image, [(18, 340, 290, -30, 60)], psf_px=8.0)
    image = draw_markers(image, [(25, 560, 320, 200, 60)], black=118.0, white=124.0)
    image = draw_markers(image, [(33, 938, 330, 15, 76), (40, 790, 130, 250, 64), (5, 420, 500, 10, 64)])
    cv2.circle(image, (762, 108), 17, 150, -1, cv2.LINE_AA)
    image[470:560, 110:230] = 62
    cells = np.kron(np.where(marker_cells(DICTIONARY, 10), 225, 30), np.ones((10, 10)))
    image[485:545, 140:200] = cells
    for u, v, side in ((640, 490, 50), (760, 520, 40)):
        cv2.fillPoly(image, [corners_of_pose([[u, v]], [0.4], [side])[0].astype(np.int32)], 40, cv2.LINE_AA)
    blurred = cv2.GaussianBlur(image, (0, 0), 0.6)
    noisy = blurred + np.random.default_rng(2).normal(0, 3, image.shape)
    return np.clip(np.rint(noisy), 0, 255).astype(np.uint8)


def main() -> None:
    """Draw the picture, run the detector, and save the explanation."""
    image = make_scene()
    found = create_detector("photometric", dictionary=DICTIONARY).detect(image)
    rejections = explain(image, DICTIONARY, found)
    picture = Image.fromarray(Annotator(SIZE_PX).draw(image, found, rejections))
    path = Path(__file__).parent.parent / "explained.jpg"
    picture.save(path, quality=85, subsampling=0, optimize=True)
    for number, rejection in enumerate(rejections, start=1):
        print(f"{number}. {rejection.reason.value}: {rejection.words}")
    print(f"{path}: {path.stat().st_size / 1e3:.0f} kB")


if __name__ == "__main__":
    main()
