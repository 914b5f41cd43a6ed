"""From coordinates at marker rate to smooth motion with derivatives, and the same filter for the forces."""

from torchid.motion.cutoff import choose_cutoff as choose_cutoff
from torchid.motion.filters import Smoother as Smoother
from torchid.motion.motion import Motion as Motion
from torchid.motion.motion import MotionOptions as MotionOptions
from torchid.motion.motion import smooth_motion as smooth_motion
