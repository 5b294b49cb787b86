"""Write three pictures of six markers and the calibration of their camera, for `skyherd survey`.

python examples/survey_pictures.py FOLDER
"""

import sys
from pathlib import Path

import cv2
import numpy as np
from PIL import Image

from skyherd.render import Camera, CameraPose, Ground, Renderer, Sensor, Shot

SIDE_M = 0.1
CAMERA = Camera((800, 600), focal_px=900.0)
POSES = [
    CameraPose((-0.9, 0.0), 1.7, 0.0, (0.0, -0.52)),
    CameraPose((0.0, -0.9), 1.7, 0.3, (-0.44, 0.0)),
    CameraPose((0.1, 0.0), 1.8, -1.0, (-0.09, 0.0)),
]
POSITIONS_M = np.array([[0.0, 0.0], [0.35, 0.1], [-0.3, 0.15], [0.1, -0.3], [-0.25, -0.25], [0.3, 0.35]])
HEADINGS_RAD = np.array([0.0, 0.5, 2.0, -1.0, 3.0, 1.0])


def main(folder: Path) -> None:
    """Write `view0.png` to `view2.png` and `camera.yaml` into a folder."""
    folder.mkdir(parents=True, exist_ok=True)
    for number, pose in enumerate(POSES):
        renderer = Renderer("4X4_50", SIDE_M, Ground(number), Sensor(2.0, np.random.default_rng(number)))
        image = renderer.render(Shot(CAMERA, pose, np.arange(6), POSITIONS_M, HEADINGS_RAD))
        Image.fromarray(image).save(folder / f"view{number}.png")
    storage = cv2.FileStorage(str(folder / "camera.yaml"), cv2.FILE_STORAGE_WRITE)
    storage.write("image_width", CAMERA.size_px[0])
    storage.write("image_height", CAMERA.size_px[1])
    storage.write("camera_matrix", CAMERA.intrinsic_matrix())
    storage.write("distortion_coefficients", np.zeros((5, 1)))
    storage.release()


if __name__ == "__main__":
    main(Path(sys.argv[1]))
