"""Joint torques, and how far they scatter with everything that they are computed from."""
