"""A scenario's world as a separate process, which takes the place of hardware."""
