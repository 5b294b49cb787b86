"""How work that takes long is done: its progress, processes side by side, and loops that are compiled."""
