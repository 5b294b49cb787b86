"""Which robots a unit controls: by a safety radius, for good or until it fails and a tree takes over.

The third policy, agreement along a tree of units from the start, is a room of its own:
`skyherd.control.tree`.
"""
