"""Which dictionary and print the markers of an image are of, if few of those looked for are found."""
