"""Runs written to MCAP files and read back."""
