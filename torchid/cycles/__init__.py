"""Cycles of a movement, and what is measured in each."""
