"""This package identifies the geometry of a subject and the posture of all frames from markers."""
