"""From coordinates at marker rate to smooth motion with derivatives."""

from torchid.filters import Smoother as Smoother
from torchid.motion.motion import Motion as Motion
from torchid.motion.motion import choose_cutoff as choose_cutoff
from torchid.motion.motion import smooth_motion as smooth_motion
