"""What is known of a subject in the end, and its tables: all that files and report are made of."""

from torchid.session.outcome import Followed as Followed
from torchid.session.outcome import Outcome as Outcome
from torchid.session.outcome import Residual as Residual
from torchid.session.session import Session as Session
