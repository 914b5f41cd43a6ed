"""What is known of a subject in the end, and its tables: all that files and report are made of."""

from torchid.outcome.outcome import Followed as Followed
from torchid.outcome.outcome import Outcome as Outcome
from torchid.outcome.outcome import Residual as Residual
from torchid.outcome.session import Session as Session
