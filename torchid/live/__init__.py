"""Identification while the subject moves: frames as they come, postures at once, parameters a stated delay later."""
