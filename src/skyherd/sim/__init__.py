"""The simulated world and what acts in it: robots, units, radio, perception, and who judges by the truth."""
