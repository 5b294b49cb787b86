"""Recording of runs to MCAP files during the run, and reading."""
