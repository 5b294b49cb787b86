"""Why a marker was not detected."""
