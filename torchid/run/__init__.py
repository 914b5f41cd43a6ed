"""The sequence of the stages, from a config to a folder of results."""

from torchid.run.sequence import run_experiment as run_experiment
from torchid.run.simulation import run_simulation as run_simulation
