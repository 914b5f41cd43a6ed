"""The outcome's former place."""

from torchid.outcome import Outcome as Outcome
from torchid.outcome import Residual as Residual
