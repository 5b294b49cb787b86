"""Work that takes long: how it reports its progress, and processes that do parts of it side by side."""
