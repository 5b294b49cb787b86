"""Studies: a scenario run many times with other parameters, on all cores or a cluster, into one table."""
