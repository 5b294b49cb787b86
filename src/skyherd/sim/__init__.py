"""The simulation: the true world, the radio, perception, the agents, and the metrics that use the truth."""
