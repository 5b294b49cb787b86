"""How robots with bodies keep apart."""
