"""Contact sheet of a labelled image set: some of its images, with their labels."""

from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt
from PIL import Image as PillowImage

from skyherd.datasets.labelled.read import Dataset, LabelledImage
from skyherd.drawing.canvas import Box, draw_text, text_width
from skyherd.drawing.palette import INK, MUTED, PAPER, rgb
from skyherd.files.atomic import write_whole
from skyherd.inspection import Annotator
from skyherd.messages import Detections
from skyherd.messages.checks import check_count, check_kind

COLUMNS, ROWS = 3, 3
"""Number of columns and rows of images. Chosen: nine show the variety, and each is still large enough."""

CELL_PX, GAP_PX, CAPTION_PX, FONT_PX = 600, 14, 26, 14
"""Width of an image on the sheet, gaps between images, height of a caption, and font size, px. Chosen by
eye."""

MAX_CELLS = 100
"""Maximum number of columns, and of rows. Chosen: the largest sheet needs 2 GB."""

Picture = npt.NDArray[np.uint8]
"""RGB image (height, width, 3)."""


def write_preview(dataset: Dataset, path: Path) -> Path:
    """Write the contact sheet of a set as PNG, and return its path.

    Raises:
        InputError: an image of the set is damaged or missing.
        OutputError: the sheet cannot be written.
    """
    sheet = PillowImage.fromarray(draw_preview(dataset))
    return write_whole(path, lambda part: sheet.save(part, format="PNG"))


def draw_preview(dataset: Dataset, columns: int = COLUMNS, rows: int = ROWS) -> Picture:
    """Draw a sheet (height, width, 3), RGB, of images evenly spread over the set, with captions.

    Raises:
        InputError: an image of the set is damaged or missing.
    """
    check_kind("draw_preview: dataset", dataset, Dataset, "a Dataset, as read_dataset returns it")
    check_count("draw_preview: columns", columns, least=1, most=MAX_CELLS)
    check_count("draw_preview: rows", rows, least=1, most=MAX_CELLS)
    count = min(columns * rows, len(dataset))
    columns, rows = min(columns, count), -(-count // min(columns, count))
    width, height = dataset.spec.size_px
    cell = (CELL_PX, max(1, round(CELL_PX * height / width)))
    pitch = np.array(cell) + GAP_PX + (0, CAPTION_PX)
    sheet = np.full((rows * pitch[1] + GAP_PX, columns * pitch[0] + GAP_PX, 3), rgb(PAPER), dtype=np.uint8)
    for k, index in enumerate((2 * np.arange(count) + 1) * len(dataset) // (2 * count)):
        left, top = GAP_PX + pitch * (k % columns, k // columns)
        image = dataset[int(index)]
        Box(int(left), int(top), *cell).of(sheet)[:] = _annotated(image, cell)
        _caption(sheet, image, (float(left), float(top + cell[1] + CAPTION_PX / 2)))
    return sheet


def _annotated(image: LabelledImage, cell: tuple[int, int]) -> Picture:
    """Draw an image in the size of a cell, with outlines, arrows and ids of its markers."""
    grey, labels = image.read(), image.labels
    scale = np.array(cell) / grey.shape[::-1]
    shrinks = scale[0] < 1
    small = cv2.resize(grey, cell, interpolation=cv2.INTER_AREA if shrinks else cv2.INTER_NEAREST)
    shown = Detections(
        unit_id=0,
        time_s=0.0,
        image_size_px=np.array(cell),
        ids=labels.ids,
        centers_px=(labels.centers_px + 0.5) * scale - 0.5,
        headings_rad=np.radians(labels.headings_deg),
        sides_px=labels.sides_px * scale[0],
        corners_px=(labels.corners_px + 0.5) * scale - 0.5,
        covariances=np.zeros((len(labels), 3, 3)),
    )
    return Annotator(cell, min_side_px=1).draw(np.asarray(small, dtype=np.uint8), shown)


def _caption(sheet: Picture, image: LabelledImage, at_px: tuple[float, float]) -> None:
    """Write file and split in ink, and the imaging conditions in grey."""
    name = f"{image.path.name} ({image.split})"
    taken = {key: float(image.taken[key]) for key in ("psf_px", "noise", "motion_px")}
    tilt = np.hypot(float(image.taken["tilt_u_deg"]), float(image.taken["tilt_v_deg"]))
    parts = [f"{len(image.labels)} markers", f"tilt {tilt:.0f}°", f"blur {taken['psf_px']:.1f} px"]
    parts += [f"motion {taken['motion_px']:.1f} px"] * (taken["motion_px"] > 0)
    parts += [f"noise {taken['noise']:.1f}"]
    draw_text(sheet, name, at_px, rgb(INK), size_px=FONT_PX, bold=True)
    after = at_px[0] + text_width(name, FONT_PX, bold=True) + FONT_PX
    draw_text(sheet, " · ".join(parts), (after, at_px[1]), rgb(MUTED), size_px=FONT_PX)
