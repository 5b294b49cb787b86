"""Warm-up loads the compiled code of a detector before the first image."""

import subprocess
import sys

import pytest

from skyherd.errors import InputError
from skyherd.vision import create_detector, detector_names, warm_up
from skyherd.vision.detectors import warm_up as warming

KERNEL = "skyherd.vision.photometric.fitting.kernels"
SCRIPT = f"""
import sys
from skyherd.vision import create_detector, warm_up
create_detector("tracking")
print("{KERNEL}" in sys.modules)
warm_up("tracking", "APRILTAG_36h11")
print("{KERNEL}" in sys.modules)
"""


def test_warm_up_loads_compiled_code() -> None:
    done = subprocess.run([sys.executable, "-c", SCRIPT], capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["False", "True"]


@pytest.mark.parametrize("name", sorted({"opencv", "photometric", "tracking"} & set(detector_names())))
@pytest.mark.parametrize("dictionary", ["4X4_50", "APRILTAG_36h11"])
def test_warm_up_detects_its_marker(name, dictionary, monkeypatch) -> None:
    """Without a detected marker, the code of the fit would not be loaded."""
    found = []

    def watched(*given, **how):
        detector = create_detector(*given, **how)
        detect = detector.detect
        monkeypatch.setattr(
            detector, "detect", lambda *image, **which: found.append(detect(*image, **which)) or found[-1]
        )
        return detector

    monkeypatch.setattr(warming, "create_detector", watched)
    warm_up(name, dictionary)
    assert [seen.ids.tolist() for seen in found] == [[0]] * 2


def test_warm_up_refuses_an_unknown_detector() -> None:
    with pytest.raises(InputError, match="no detector"):
        warm_up("none", "4X4_50")
