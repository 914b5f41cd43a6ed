"""Which measures an evaluation has of every cycle, and their rows."""
