"""Joint torques, how far they scatter with everything that they are computed from, and motion that obeys its forces."""
