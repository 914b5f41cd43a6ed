"""This folder tests causes on held-out motion and one by one."""
