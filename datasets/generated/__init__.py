"""Missions at random, for benchmarks and tests."""
