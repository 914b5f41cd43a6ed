"""The page of a study that an ergonomist can hand on."""
