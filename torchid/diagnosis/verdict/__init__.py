"""Causes with size, confidence and rivals, and their table."""
