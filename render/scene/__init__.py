"""What lies on the ground besides markers."""
