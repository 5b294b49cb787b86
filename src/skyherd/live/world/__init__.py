"""A scenario's world as a process of its own, which is hardware to the rest of the system."""
