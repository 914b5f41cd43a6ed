"""Comparisons with other programs; run by ``scripts/bench``."""
