"""Style of the interactive pages."""
