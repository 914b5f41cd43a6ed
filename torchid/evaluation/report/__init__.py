"""The page of an evaluation that an ergonomist can hand on."""
