"""Equations of motion of a tree, and their base rows: linear in the inertial parameters, whitened."""
