"""Synthetic subjects, their motion, and what a laboratory would measure of it."""

from torchid.simulate.options import SimulateOptions as SimulateOptions
from torchid.simulate.session import Session as Session
from torchid.simulate.session import simulate_session as simulate_session
from torchid.simulate.subject import SimulatedSubject as SimulatedSubject
from torchid.simulate.subject import simulate_subject as simulate_subject
from torchid.simulate.trial import SimulatedTrial as SimulatedTrial
from torchid.simulate.trial import simulate_trial as simulate_trial
