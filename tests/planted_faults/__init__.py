"""Faults planted into real recordings: which sessions there are, what is planted where, and the truth about it."""
