"""Control topology: conditions TC1-TC5, the rate of convergence, the slot clock."""
