"""Studies: a scenario run many times with varied parameters, on all cores or a cluster, into one table."""
