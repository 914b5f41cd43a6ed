"""The default solver: Levenberg-Marquardt on all frames, whose normal matrix has the shape of an arrow."""
