"""Labelled image sets: specified, drawn, written, read and checked."""
