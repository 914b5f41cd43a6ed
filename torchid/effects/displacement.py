"""Changes of the wrench that a motion needs by small displacements of its bodies.

With P = sum m c' and H = sum c x m c' + I w about the origin of W, what is needed is the rate of (P, H) and gravity's
share. A displacement d of a body's origin and a rotation e of it move its centre of mass by s = d + e x r and turn I w
into I w + e x I w + I e', whatever w is. Products by parts leave three vectors that are linear in (d, e) itself:

    A = sum m s,  B = sum c x m s + I e,  C = sum 2 s x m c' + e x I w - w x I e + I (w x e)
    change of force = A'',  change of moment = B'' + C' + A x (minus gravity)
"""

import torch
from jaxtyping import Float
from torch import Tensor

from torchid.conventions import GRAVITY
from torchid.dynamics.equations_of_motion import joint_axes
from torchid.effects.scene import Scene
from torchid.kinematics.recursion import cross


def displaced(scene: Scene, bodies: Float[Tensor, "columns bodies 6 frames"]) -> Float[Tensor, "columns 6 frames"]:
    """Change of ``Scene.needed`` where bodies are displaced a little, to first order.

    Args:
        scene: motion and inertia.
        bodies: displacement of each body's origin [m] and its rotation [rad], W axes, plan order.
    """
    nine = levers(scene) @ bodies.permute(3, 1, 2, 0).flatten(1, 2)
    return wrench_of(nine.permute(2, 1, 0), scene.rate)


def wrench_of(nine: Float[Tensor, "columns 9 frames"], rate_hz: float) -> Float[Tensor, "columns 6 frames"]:
    """Change of the wrench about the origin of W [N, N m] from the vectors A, B, C (see the module)."""
    A, B, C = nine.split(3, 1)
    moment = rate_of(rate_of(B, rate_hz).add_(C), rate_hz)
    moment[:, 0].add_(A[:, 1], alpha=GRAVITY)
    moment[:, 1].sub_(A[:, 0], alpha=GRAVITY)
    return torch.cat([rate_of(rate_of(A, rate_hz), rate_hz), moment], 1)


def rate_of(x: Float[Tensor, "*some frames"], rate_hz: float) -> Float[Tensor, "*some frames"]:
    """Time derivative by differences of sixth order, and of second order at the ends.

    It is meant for courses whose frequencies are far below the frame rate: at a tenth of it, it is 0.04 % short.
    """
    found = torch.empty_like(x, memory_format=torch.contiguous_format)
    inner = found[..., 3:-3]
    torch.sub(x[..., 4:-2], x[..., 2:-4], out=inner)
    inner.mul_(45.0).sub_(x[..., 5:-1], alpha=9.0).add_(x[..., 1:-5], alpha=9.0)
    inner.add_(x[..., 6:]).sub_(x[..., :-6]).mul_(rate_hz / 60.0)
    for k, step in ((0, 1), (-1, -1)):
        found[..., k] = step * rate_hz * (-1.5 * x[..., k] + 2.0 * x[..., k + step] - 0.5 * x[..., k + 2 * step])
    for k in (1, 2, -2, -3):
        found[..., k] = 0.5 * rate_hz * (x[..., k + 1] - x[..., k - 1])
    return found


def levers(scene: Scene) -> Float[Tensor, "frames 9 rows"]:
    """Vectors A, B, C (see the module) per displacement [m] and rotation [rad] of every body, six rows a body in plan
    order."""
    plan, at, motion = scene.state.plan, scene.state.at, scene.state.motion
    phi = scene.phi[list(plan.order)]
    mass, arm = phi[:, 0], phi[:, 1:4] / phi[:, :1]
    offset = torch.einsum("bcit,bc->bit", at.R, arm)
    own = inertia_matrix(phi[:, 4:]) - mass[:, None, None] * _shell(arm)
    inertia = torch.einsum("bkit,bkl,bljt->tbij", at.R, own, at.R)
    r, c, w = (_spin(x) for x in (offset, at.p + offset, motion.w))
    v = _spin(motion.v + cross(motion.w, offset))
    L = _spin(torch.einsum("tbij,bjt->bit", inertia, motion.w))
    m, eye = mass[:, None, None], torch.eye(3).to(r).expand_as(r)
    d = [m * eye, m * c, -2.0 * m * v]
    e = [-m * r, inertia - m * c @ r, 2.0 * m * v @ r - L - w @ inertia + inertia @ w]
    both = torch.cat([torch.cat(d, 2), torch.cat(e, 2)], 3)
    return both.permute(0, 2, 1, 3).flatten(2)


def _spin(x: Float[Tensor, "bodies 3 frames"]) -> Float[Tensor, "frames bodies 3 3"]:
    """The matrices M with M y = x cross y."""
    a, b, c = x.permute(1, 2, 0)
    zero = torch.zeros_like(a)
    return torch.stack([zero, -c, b, c, zero, -a, -b, a, zero], 2).view(*a.shape, 3, 3)


def inertia_matrix(six: Float[Tensor, "bodies 6"]) -> Float[Tensor, "bodies 3 3"]:
    """Inertias given as Ixx, Ixy, Iyy, Ixz, Iyz, Izz as symmetric matrices."""
    xx, xy, yy, xz, yz, zz = six.unbind(1)
    return torch.stack([xx, xy, xz, xy, yy, yz, xz, yz, zz], 1).view(-1, 3, 3)


def _shell(arm: Float[Tensor, "bodies 3"]) -> Float[Tensor, "bodies 3 3"]:
    """Inertia |c|^2 1 - c c' of a unit mass at c."""
    eye = torch.eye(3).to(arm)
    return arm.square().sum(1)[:, None, None] * eye - arm[:, :, None] * arm[:, None]


def carriage(scene: Scene) -> Float[Tensor, "frames rows dofs"]:
    """Displacement and rotation of every body per unit of each coordinate, in W, six rows a body in plan order; the
    coordinates 3 to 5 are rotations of the root in W."""
    S, _ = joint_axes(scene.state)
    mask = supports(scene).to(S)[:, :, None, None]
    turn = mask * S[None, :, 3:]
    arm = (scene.state.at.p - scene.state.at.p[:1])[:, None].expand_as(turn)
    both = torch.cat([mask * S[None, :, :3] + cross(turn, arm), turn], 2)
    both = scene.tree.fold(scene.state.at.q, both.transpose(0, 1)).transpose(0, 1)
    return both.permute(3, 0, 2, 1).flatten(1, 2).contiguous()


def coordinate_levers(scene: Scene) -> Float[Tensor, "9 dofs frames"]:
    """Vectors A, B, C (see the module) per unit of each coordinate: ``levers`` times ``carriage``, by sums over what
    each joint carries."""
    state = scene.state
    own = levers(scene).unflatten(2, (-1, 6)).permute(2, 1, 3, 0).contiguous()
    arm = (state.at.p - state.at.p[:1])[:, None].expand(-1, own.shape[1], -1, -1)
    own[:, :, 3:] += cross(arm, own[:, :, :3])
    carried = (state.at.tables.above.mT @ own.flatten(1)).view_as(own)
    S, body = joint_axes(state)
    found = torch.einsum("jikt,jkt->jit", carried[body], S)
    return scene.tree.fold(state.at.q, found).transpose(0, 1).contiguous()


def supports(scene: Scene) -> Tensor:
    """(bodies, axes) whether a body, by plan position, moves with an axis value."""
    plan = scene.state.plan
    above = torch.zeros(len(plan.order), plan.tree.n_axes, dtype=torch.bool)
    above[:, :6] = True
    for column in plan.motion:
        for body, ancestors in enumerate(plan.tree.ancestors):
            above[plan.position[body], column.row] |= column.body in ancestors
    return above.to(scene.phi.device)


def below(scene: Scene, segment: str) -> Float[Tensor, " bodies"]:
    """1 for a segment and everything that it carries, plan order."""
    tree, position = scene.tree, scene.state.plan.position
    inside = scene.phi.new_zeros(len(position))
    inside[[position[k] for k in tree.subtree(tree.index(segment))]] = 1.0
    return inside
