"""Who controls whom: conditions TC1-TC5, the rate of convergence, sets by a safety radius."""
