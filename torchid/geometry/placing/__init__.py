"""Markers whose labels say nothing, placed on the body by where they stand and how they move."""
