"""Units, effects and permutation tests of what conditions differ by."""
