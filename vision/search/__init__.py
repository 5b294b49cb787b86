"""From an image to quadrilaterals that resemble markers: dark regions, their outlines, decoded ids.

`regions` finds dark regions where dark pixels crowd, `quads` finds quadrilaterals among their boundaries,
`second_look` finds those that this loses, and `decode` compares their cells with every marker of a
dictionary. Nothing is refused here for a doubtful bit; that is decided by the fit
(`skyherd.vision.photometric`), which uses all pixels.
"""
