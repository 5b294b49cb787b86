"""The topology of who controls whom: conditions TC1-TC5, the rate of convergence, the slot clock."""
