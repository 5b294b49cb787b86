"""Analysis of a run's steps: history as arrays, summary, and topology report."""
