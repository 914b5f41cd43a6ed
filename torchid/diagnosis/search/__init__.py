"""This folder names causes: a scan of all candidates, one cause a round, rivals, elimination."""
