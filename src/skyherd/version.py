"""The version of the package, which `pyproject.toml` reads from here, and when it was imported."""

import time

__version__ = "0.2.0"

STARTED_S = time.time()
"""Time of day of the first import, s since 1970: some hundredths of a second after a command was given."""
