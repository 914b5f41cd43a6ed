"""OpenSim models in: read as their laboratory wrote them, posed in torch, and written back into their own text."""
