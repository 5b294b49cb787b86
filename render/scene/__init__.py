"""The ground besides markers: textures, clutter, and occluders."""
