"""Why markers were not detected: the results of the detector's searches, in words.

`explain` is the entrance. Nothing of the control loop depends on this package.
"""
