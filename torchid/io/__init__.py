"""Files in and out: every unit, axis and format is converted here and nowhere else."""

from torchid.io.options import ReadOptions as ReadOptions
from torchid.io.trial import read_trial as read_trial
