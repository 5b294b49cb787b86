"""Labelled image sets: specification, rendering, writing, reading and checks.

The stages of an image are:

- `spec`: ranges of all variables;
- `sampling`: a scene, drawn from seed and number;
- `scenes`: image, ground truth and Cramér–Rao bound;
- `labels`: the ground truth, rounded once;
- `coco`, `yolo` and `truth_table`: the file formats, and `preview`: a contact sheet.

`make` runs these stages in parallel. It saves no state for interrupted sets: labels are cheap, and are drawn
again. `check` compares the files with new ones from the truth table, redraws a sample of images from the
seed, and runs the detector on it (`agreement`).

A pixel's centre is an integer in the truth table, and at halves in COCO and YOLO, whose origin is the image's
corner.
"""
