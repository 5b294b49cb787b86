"""The protocol by which units share robots along a tree."""
