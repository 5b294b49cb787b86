"""Long-running work: progress and parallel processes."""
