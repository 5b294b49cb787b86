"""Random missions for benchmarks and tests: units, robots and shapes drawn from a seed."""
