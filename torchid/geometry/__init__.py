"""Geometry and posture from markers, all frames at once."""
