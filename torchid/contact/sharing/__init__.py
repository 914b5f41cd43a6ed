"""Which contact bears what of a wrench that several of them share: one convex problem over all frames of a trial."""
