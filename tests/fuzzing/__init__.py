"""Damaged files for torchid's readers, and what becomes of each."""
