"""What a labelled set is written as: its tables of truth, and the formats of others."""
