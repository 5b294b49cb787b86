"""Scene besides markers: ground textures, clutter and occluders."""
