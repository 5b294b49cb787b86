"""Templates that all pages share, and that of a run's page."""
