"""Named formation shapes, and words written by robots."""
