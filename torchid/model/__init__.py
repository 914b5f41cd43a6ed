"""What a body is: its tree, landmarks and priors, from tables, URDF, MJCF or OpenSim."""
