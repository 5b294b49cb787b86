"""Make sensor.png: one scene through every part of lens, sensor and processing.

python docs/scripts/make_sensor_figure.py            # writes docs/sensor.png
"""

from pathlib import Path

import cv2
import numpy as np

from skyherd.drawing.canvas import draw_text
from skyherd.drawing.palette import INK, PAPER, rgb
from skyherd.render import (
    Camera,
    CameraPose,
    Clutter,
    Disc,
    Distortion,
    Ground,
    Illumination,
    LensBlur,
    Mosaic,
    Motion,
    Processing,
    Quad,
    Renderer,
    Sensor,
    Shot,
    Shutter,
)

SIZE_PX, FOCAL_PX, HEIGHT_M = (300, 225), 230.0, 9.0
TITLE_PX, GAP_PX, COLUMNS = 24, 8, 4
POSE = CameraPose((0.0, 0.0), HEIGHT_M, 0.1)
MOTION = Motion((2.5, 0.8, 0.0), 0.5)


def team() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return ids, positions and headings of twenty robots on a jittered grid."""
    rng = np.random.default_rng(5)
    grid = np.stack(np.meshgrid(np.arange(5) - 2.0, np.arange(4) - 1.5), axis=-1).reshape(-1, 2)
    return np.arange(20), 2.2 * grid + rng.uniform(-0.4, 0.4, grid.shape), rng.uniform(-np.pi, np.pi, 20)


def draw(
    *,
    ground: Ground | None = None,
    sensor: Sensor | None = None,
    pose: CameraPose = POSE,
    distortion: Distortion | None = None,
    shutter: Shutter | None = None,
    psf_px: float = 0.8,
    lens_blur: LensBlur | None = None,
    covered: bool = False,
) -> np.ndarray:
    """Return the scene with some settings changed."""
    renderer = Renderer(
        "4X4_50",
        1.0,
        ground or Ground(3, contrast=10.0),
        sensor or Sensor(0.0, np.random.default_rng(1)),
        psf_px=psf_px,
        shutter=shutter or Shutter(),
        lens_blur=lens_blur or LensBlur(),
    )
    camera = Camera(SIZE_PX, FOCAL_PX, distortion=distortion or Distortion())
    over = [Disc((0.2, 1.0), 0.6, 60.0), Quad([[2.0, -1.6], [4.0, -1.0], [3.8, -0.4], [1.8, -1.0]], 190.0)]
    return renderer.render(Shot(camera, pose, *team(), motion=MOTION, occluders=over if covered else ()))


def sensor(noise: float = 0.0, jpeg_quality: int | None = None, shot: float = 0.0, **light: float) -> Sensor:
    """Return a sensor with some stages enabled."""
    return Sensor(
        noise,
        np.random.default_rng(1),
        shot=shot,
        jpeg_quality=jpeg_quality,
        illumination=Illumination(**light),
    )


def processed(noise: float = 0.0, **steps: object) -> np.ndarray:
    """Return the scene through some processing stages."""
    camera = Sensor(noise, np.random.default_rng(1), processing=Processing(**steps))
    return draw(sensor=camera)


def panels() -> dict[str, np.ndarray]:
    """Return pictures by title."""
    tilt = CameraPose((0.0, 3.2), HEIGHT_M, 0.1, (np.radians(20.0), 0.0))
    return {
        "as it is": draw(),
        "tilt 20°": draw(pose=tilt),
        "lens k1 = -0.35": draw(distortion=Distortion(k1=-0.35, k2=0.08)),
        "blur 1.5 px": draw(psf_px=1.5),
        "exposure 0.1 s": draw(shutter=Shutter(exposure_s=0.1)),
        "row time 1 ms": draw(shutter=Shutter(row_time_s=1e-3)),
        "read noise 10, shot noise 0.5": draw(sensor=sensor(10.0, shot=0.5)),
        "gradient 0.6, shadow 0.5": draw(
            sensor=sensor(gradient=0.6, shadow=0.5, shadow_rad=2.2, shadow_offset=0.2, shadow_edge=0.05)
        ),
        "vignetting 0.6, JPEG 20": draw(sensor=sensor(vignetting=0.6, jpeg_quality=20)),
        "tiles of 1 m": draw(ground=Ground(3, kind="tiles", tile_m=1.0, contrast=9.0)),
        "clutter 0.8 /m²": draw(ground=Ground(3, contrast=10.0, clutter=Clutter(3, 0.8, (0.4, 1.2)))),
        "disc and quad over markers": draw(covered=True),
        "disc of defocus 2 px": draw(lens_blur=LensBlur(disc_px=2.0), psf_px=0.5),
        "coma C = 1.5 px": draw(lens_blur=LensBlur(coma_px=1.5), psf_px=0.5),
        "tilt 20°, aperture 0.6 m": draw(pose=tilt, lens_blur=LensBlur(aperture_m=0.6, focus_m=11.0)),
        "noise 10, Bayer, balance 2": processed(10.0, mosaic=Mosaic("edge-aware", 2.0, 2.0)),
        "gamma 2.2": processed(gamma=2.2),
        "noise 10, denoising 25": processed(10.0, denoise=25.0),
        "sharpening 2": processed(sharpen=2.0),
        "H.264, rate factor 40": processed(2.0, h264_crf=40),
    }


def main() -> None:
    """Arrange the panels and write the figure."""
    pictures = panels()
    width, height = SIZE_PX
    rows = -(-len(pictures) // COLUMNS)
    size = (rows * (height + TITLE_PX + GAP_PX), COLUMNS * (width + GAP_PX) - GAP_PX)
    sheet = np.full((*size, 3), rgb(PAPER), dtype=np.uint8)
    for number, (title, picture) in enumerate(pictures.items()):
        row, column = divmod(number, COLUMNS)
        top, left = row * (height + TITLE_PX + GAP_PX), column * (width + GAP_PX)
        draw_text(sheet, title, (left + 2, top + TITLE_PX / 2), rgb(INK), size_px=14)
        sheet[top + TITLE_PX : top + TITLE_PX + height, left : left + width] = picture[..., None]
    file = Path(__file__).parent.parent / "sensor.png"
    cv2.imwrite(str(file), cv2.cvtColor(sheet, cv2.COLOR_RGB2GRAY), [cv2.IMWRITE_PNG_COMPRESSION, 9])
    print(f"{file}: {file.stat().st_size / 1e3:.0f} kB")


if __name__ == "__main__":
    main()
