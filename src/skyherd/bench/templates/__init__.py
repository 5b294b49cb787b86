"""Template of the page of the detectors' benchmark."""
