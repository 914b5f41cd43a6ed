"""This folder says how much better a candidate explains the recordings: prior, noise, statistics, posterior."""
