"""Settings of the tree protocol, under the name that the rest of the package uses."""

from skyherd.control.tree.node_state import TreeRule as TreeSettings

__all__ = ["TreeSettings"]
