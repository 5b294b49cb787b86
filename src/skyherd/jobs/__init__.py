"""Long-running work: progress, parallel processes, and compiled loops."""
