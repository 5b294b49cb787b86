"""Finding markers in picture and video files: what `skyherd detect` does."""
