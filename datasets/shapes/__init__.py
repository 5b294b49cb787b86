"""Named formation shapes, and words that robots write."""
