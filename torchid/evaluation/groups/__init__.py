"""Groups of a cohort compared: how their people walk, with every person as one unit."""
