"""File formats of a labelled set: tables of ground truth, COCO and YOLO."""
