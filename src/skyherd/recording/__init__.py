"""Runs written to MCAP files while they go on, and read back."""
