"""skyherd steers ground robots into a shape with nothing but what uncalibrated flying cameras see."""

__version__ = "0.1.0"
