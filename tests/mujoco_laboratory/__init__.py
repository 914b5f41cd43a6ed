"""A gait laboratory with MuJoCo as physics and not a line of torchid in it, which the diagnosis is held against."""
