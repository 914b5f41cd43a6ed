"""Runs that are disturbed on purpose, and what is left of them (`scripts/faults`)."""
