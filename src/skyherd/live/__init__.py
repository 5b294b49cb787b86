"""The same code on real hardware: cameras in, robots out."""
