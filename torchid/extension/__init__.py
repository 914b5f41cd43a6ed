"""The model extended by what the diagnosis names, corrected recordings, and whether predictions gain by it."""
