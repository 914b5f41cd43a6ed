"""Poses, marker positions and accelerations of a tree, batched over frames."""
