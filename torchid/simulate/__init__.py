"""Synthetic subjects, their motion, and what a laboratory would measure of it."""
