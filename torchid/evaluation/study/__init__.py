"""Several subjects' evaluations as one: read, tested over subjects, and reported."""
