"""The sequence of the stages, from a config to a folder of results."""

from torchid.experiment.run import run_experiment as run_experiment
from torchid.experiment.simulation import run_simulation as run_simulation
