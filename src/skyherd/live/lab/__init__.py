"""Lab files, such as `lab.toml`: shape, markers, cameras, robots, radio and limits of one set-up."""

from skyherd.live.lab.checks import check_drivers
from skyherd.live.lab.models import LabModel, LabRadio
from skyherd.live.lab.reading import lab_names, lab_text, load_lab, make_lab
from skyherd.live.lab.set_up import Lab

__all__ = ["Lab", "LabModel", "LabRadio", "check_drivers", "lab_names", "lab_text", "load_lab", "make_lab"]
