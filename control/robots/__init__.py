"""What a robot does with the goals it was sent."""
