"""Why markers were not detected: a second, slow and thorough look, for people who set up cameras and markers.

`explain` is the entrance. Nothing of the control loop depends on this package.
"""
