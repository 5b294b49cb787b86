"""What is worked out from a run's steps: history, summary, and its topology judged."""
