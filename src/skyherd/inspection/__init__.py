"""Marker detection in pictures and videos, with outputs for people: `skyherd detect`, and `skyherd.detect`.

`Inspector` runs a detector over files and writes tables (`detection_rows`, `rejection_rows`) and annotated
pictures (`Annotator`) into a folder.
"""

from skyherd.inspection.annotator import Annotator
from skyherd.inspection.file_result import FileResult
from skyherd.inspection.inspector import AUTO, DETECTIONS, REJECTIONS, Inspector
from skyherd.inspection.output_names import output_name
from skyherd.inspection.single_image import annotate, detect
from skyherd.inspection.table import (
    FORMATS,
    Format,
    Place,
    detection_rows,
    open_table,
    rejection_rows,
)

__all__ = [
    "AUTO",
    "DETECTIONS",
    "FORMATS",
    "REJECTIONS",
    "Annotator",
    "FileResult",
    "Format",
    "Inspector",
    "Place",
    "annotate",
    "detect",
    "detection_rows",
    "open_table",
    "output_name",
    "rejection_rows",
]
