"""What there is on the ground besides markers: textures, clutter, and what covers markers."""
