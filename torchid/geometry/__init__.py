"""Segment lengths, joint centres, marker places and postures of all frames, from markers."""
