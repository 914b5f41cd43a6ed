"""Which causes are named: a scan of all candidates, one cause a round, rivals, elimination."""
