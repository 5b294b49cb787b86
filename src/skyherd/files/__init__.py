"""Files: written whole or not at all; pictures and videos, read and written."""
