"""The protocol by which units share robots in pairs along a tree, so that TC1-TC5 hold at every instant.

Start at `protocol.py`: it has the rules in their order, and the one place that changes a unit's state.
"""
