"""Scenario files: their keys, checked, and the missions made of them."""
