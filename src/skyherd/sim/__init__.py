"""Simulation: the true world, the radio, perception, the agents, and ground-truth metrics."""
