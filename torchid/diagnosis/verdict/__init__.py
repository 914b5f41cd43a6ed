"""This folder makes causes with size, confidence and rivals, and their table."""
