"""Marker candidates of an image: adaptive threshold, quadrilaterals, decoding.

- `regions` thresholds the parts of the image with a high density of dark pixels.
- `quads` fits quadrilaterals to the boundaries of the dark regions, also in images of twice the size.
- `faint` does so after the contrast of faint places was stretched.
- `crossed` does so after lines that cross the outlines of squares were removed.
- `decode` correlates the cells of quadrilaterals with every marker of a dictionary.
- `edges` refines corners by the image gradient.

No candidate is rejected for a wrong bit. `skyherd.vision.photometric` decides with all pixels.
"""
