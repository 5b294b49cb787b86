"""Evidence that a candidate shows a marker: readings, hypotheses fitted to them, and log odds."""
