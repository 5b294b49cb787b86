"""What a camera does to the ground, learned from the markers, and taken off the detections."""
