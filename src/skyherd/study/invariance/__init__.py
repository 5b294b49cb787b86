"""Study of cameras: measured and predicted sensitivity of a run to each camera parameter."""
