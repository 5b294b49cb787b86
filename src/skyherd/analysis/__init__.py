"""What is computed from a run's steps: its history as arrays, its summary, and a report on its topology."""
