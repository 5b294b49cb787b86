"""Recordings of live processes: writing, reading, and replay of their decisions."""
