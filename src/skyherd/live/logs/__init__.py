"""What live processes record, how that is read, and how their decisions are made again from it."""
