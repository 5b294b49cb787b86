"""Tree protocol: units share robots in pairs along a tree, so that TC1-TC5 hold at every instant.

Start at `protocol.py`. It has the rules in their order, and is the only place that changes a unit's state.
"""
