"""This folder lists what could be hidden, where, and when."""
