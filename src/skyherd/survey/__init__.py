"""Survey of markers and cameras: pictures of calibrated cameras to poses in one frame, in metres.

Start with `take_views` and `survey`.
"""

from skyherd.survey.layout import layout_text
from skyherd.survey.measure import Survey, survey
from skyherd.survey.output import CAMERAS, FRAME, MARKERS, PLAN, output_folder, write_survey
from skyherd.survey.views import take_views

__all__ = [
    "CAMERAS",
    "FRAME",
    "MARKERS",
    "PLAN",
    "Survey",
    "layout_text",
    "output_folder",
    "survey",
    "take_views",
    "write_survey",
]
