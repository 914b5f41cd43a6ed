"""What is written and taken up again: results of a run, stored stages, files written whole or not at all."""
