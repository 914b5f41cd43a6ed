"""From accumulated equations and a prior to physically consistent inertial parameters, with what the data decided."""

from torchid.inertia.certificate import InertiaStatus as InertiaStatus
from torchid.inertia.fit import InertiaFit as InertiaFit
from torchid.inertia.fit import fit_inertia as fit_inertia
from torchid.inertia.options import InertiaOptions as InertiaOptions
