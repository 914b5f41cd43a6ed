"""From accumulated equations and a prior to physically consistent inertial parameters, with what the data decided."""
