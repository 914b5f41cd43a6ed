"""Torques of one trial in shares: what motion and contacts demand, what the device does, and what is left to the human.

With inverse dynamics ID of the body and the parts that it carries, plates' wrenches F_c and the device's generalised
force tau_d, grounded supports included: demand = ID(phi + parts; q, v, a) - J' F_c, human = demand - tau_d.
"""

from dataclasses import dataclass

from jaxtyping import Float
from torch import Tensor

from torchid.contact.sharing.records import ContactWrenches
from torchid.evaluation.torque_shares.back import LowBack, low_back
from torchid.evaluation.torque_shares.wearing import Worn, acting, carried
from torchid.evaluation.trials import ConditionTrial
from torchid.geometry.result import GeometryFit
from torchid.session import Followed
from torchid.session.following import contact_loads, torques


@dataclass(frozen=True)
class Shares:
    """One trial with one body; torques NaN where a contact is not known."""

    demand: Float[Tensor, "frames dofs"]
    device: Float[Tensor, "frames dofs"]
    q: Float[Tensor, "frames dofs"]
    v: Float[Tensor, "frames dofs"]
    back: LowBack | None

    @property
    def human(self) -> Float[Tensor, "frames dofs"]:
        """Demand minus the device's share [N m]."""
        return self.demand - self.device


def shares(
    trial: ConditionTrial,
    followed: Followed,
    fit: GeometryFit,
    phi: Float[Tensor, "bodies 10"],
    worn: Worn,
    recorded: dict[str, Tensor],
    under: ContactWrenches | None = None,
) -> Shares:
    """Shares of one trial.

    Args:
        followed: its motion with this body.
        phi: inertial parameters of this body alone.
        recorded: the device's channels on the motion's frames.
        under: wrenches of the contacts, shared and predicted ones too; None takes what plates bear of one alone.

    Raises:
        ConfigError: ``device.*``.
    """
    tree, geometry, motion = fit.model.tree, fit.geometry, followed.motion
    both = carried(worn, tree, phi)
    demand = torques(followed, tree, geometry, both, trial.recording, under)
    action = acting(worn, tree, geometry, motion, recorded)
    back = low_back(tree, geometry, both, motion, contact_loads(followed, trial.recording, under))
    return Shares(demand, action.torque, motion.q, motion.v, back)
