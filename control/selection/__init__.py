"""Selection of the robots that a unit controls: by a safety radius, permanently or until a tree takes over.

The third policy, agreement along a tree of units from the start, is a package of its own:
`skyherd.control.tree`.
"""
