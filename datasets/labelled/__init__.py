"""Labelled image sets: specified, drawn, written, read and checked.

The way of an image: `spec` (what varies, and in which range), `sampling` (a scene, drawn from seed and
number), `scenes` (image, truth and bound), `labels` (rounded once), and the layouts `coco`, `yolo` and
`truth_table`, with a `preview`. `make` runs this in parallel. Nothing of an image is kept to go on with an
interrupted set: labels are cheap, and are drawn again. `check` makes the layouts from the truth table anew
and compares them, draws a sample again from the seed, and has the detector look at it (`agreement`).

A pixel's centre is an integer in the truth table, and at halves in COCO and YOLO, whose origin is the image's
corner.
"""
