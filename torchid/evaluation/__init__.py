"""Assistive devices evaluated: conditions compared, with what is sure about the comparison."""
