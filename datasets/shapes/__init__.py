"""Shapes to form, words among them."""
