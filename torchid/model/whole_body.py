"""The built-in model of a person, scaled by stature, mass and sex, and bodies locked where no marker sees them."""

from dataclasses import replace

import torch

from torchid.errors import ConfigError, Note
from torchid.model.anthropometry import inertial_prior
from torchid.model.build import age_said, build_of
from torchid.model.geometry_prior import whole_body_geometry
from torchid.model.landmarks import whole_body_landmarks
from torchid.model.model import GeometryPrior, Model
from torchid.model.proportions import proportions, stature
from torchid.model.skeleton import whole_body_tree
from torchid.model.tree import BASE_DOFS, Body, Tree

SOURCES = (
    "joint signs: Wu et al. 2002, 2005 (ISB)",
    "lengths: de Leva 1996; Drillis & Contini 1966 in Winter 2009; Gordon et al. 2014 (ANSUR II)",
    "hip centres: Harrington et al. 2007",
    "ankle and subtalar axes: Inman 1976",
    "inertia: de Leva 1996",
)


def whole_body(
    height: float | None, mass: float | None, sex: str = "unknown", mass_sd: float | None = None,
    age: float | None = None,
) -> Model:  # fmt: skip
    """Template of 16 bodies and 41 coordinates with priors of geometry, inertia and landmarks (float64, CPU).

    Args:
        height: stature [m]; None: mean of that sex and age, with its scatter in every length.
        mass: [kg]; None: from the stature, widely.
        sex: male, female or unknown.
        mass_sd: scatter of the given mass [kg].
        age: [years]; None: an adult's, unless the stature is a child's.

    Raises:
        ConfigError: a value is no person's.
    """
    tall, tall_sd = stature(height, sex, age)
    shape = proportions(sex)
    tree = whole_body_tree(shape.hip_height * tall)
    geometry = whole_body_geometry(tree, shape, tall, tall_sd)
    of_whom = "of adults" if age is None else f"at {age_said(age)}"
    sources = SOURCES if height is not None else (*SOURCES, f"height not given: {tall:.3f} m, mean {of_whom} ({sex})")
    build = build_of(height, mass, age).said
    return Model(
        tree=tree,
        geometry=geometry,
        inertia=inertial_prior(geometry.geometry(geometry.mean), height, mass, mass_sd, sex, age),
        landmarks=whole_body_landmarks(shape, tall),
        height=tall,
        sources=(*sources, *(f"shares of mass: adults' tables, {line}" for line in build)),
        build=build,
        of_stature=height is not None,
    )


def lock_bodies(model: Model, bodies: tuple[str, ...]) -> tuple[Model, tuple[Note, ...]]:
    """Fix bodies rigidly to their parents, as for segments without markers.

    Their coordinates and hinge angles leave the model. Parameters of geometry that then move nothing but locked bodies
    without free bodies below are held at their mean. The bodies keep their inertia.

    Raises:
        ConfigError: a body is unknown or is the root.
    """
    tree = model.tree
    locked = {_known(tree, name) for name in bodies}
    if not locked:
        return model, ()
    if tree.coupling is not None:
        return _hold_coordinates(model, locked)
    dofs = _kept([turn.row for k, b in enumerate(tree.bodies) if k not in locked for turn in b.turns if turn.moving]
                 + [slide.row for k, b in enumerate(tree.bodies) if k not in locked for slide in b.slides]
                 + list(range(BASE_DOFS)))  # fmt: skip
    hinges = _kept([t.row for k, b in enumerate(tree.bodies) if k not in locked for t in b.turns if not t.moving])
    reduced = Tree(
        tuple(_rewired(body, dofs, hinges, k in locked) for k, body in enumerate(tree.bodies)),
        tuple(dof for k, dof in enumerate(tree.dofs) if k in dofs),
        tuple(name for k, name in enumerate(tree.hinges) if k in hinges),
    )
    geometry, held = _hold(model.geometry, tree, locked, hinges)
    gone = [dof.name for k, dof in enumerate(tree.dofs) if k not in dofs]
    message = f"{', '.join(tree.names[k] for k in sorted(locked))} fixed to the parent; no longer moves: "
    message += ", ".join(gone) + (f"; held at the prior's mean: {', '.join(held)}" if held else "")
    return replace(model, tree=reduced, geometry=geometry), (Note("model.locked", message),)


def _hold_coordinates(model: Model, bodies: set[int]) -> tuple[Model, tuple[Note, ...]]:
    """Hold the coordinates that move none but these bodies at rest; what follows other coordinates goes on to."""
    tree, hinges = model.tree, {k: k for k in range(len(model.tree.hinges))}
    assert tree.coupling is not None
    moved = {row: {k for k in range(len(tree.bodies)) if row in tree.driving(k)} for row in range(len(tree.dofs))}
    rows = [row for row in range(BASE_DOFS, len(tree.dofs)) if moved[row] <= bodies]
    place = tree.coupling.renumber(rows)
    reduced = Tree(
        tuple(_rewired(body, place, hinges, False) for body in tree.bodies),
        tuple(dof for k, dof in enumerate(tree.dofs) if k not in rows),
        tree.hinges,
        tree.coupling.hold({row: tree.dofs[row].rest for row in rows}),
    )
    geometry, held = _hold(model.geometry, tree, bodies, hinges)
    message = f"{', '.join(tree.names[k] for k in sorted(bodies))} without markers"
    message += f"; held at rest: {', '.join(tree.dof_names[row] for row in rows)}" if rows else ""
    message += f"; held at the prior's mean: {', '.join(held)}" if held else ""
    return replace(model, tree=reduced, geometry=geometry), (Note("model.locked", message),)


def _known(tree: Tree, name: str) -> int:
    if name not in tree.names[1:]:
        raise ConfigError(
            "model.body", "this body cannot be locked", place=name, found="the root" if name in tree.names else "",
            remedy=f"bodies: {', '.join(tree.names[1:])}",
        )  # fmt: skip
    return tree.index(name)


def _kept(rows: list[int]) -> dict[int, int]:
    """Old row to new row."""
    return {row: k for k, row in enumerate(sorted(set(rows)))}


def _rewired(body: Body, dofs: dict[int, int], hinges: dict[int, int], locked: bool) -> Body:
    if locked:
        return replace(body, turns=(), slides=())
    turns = tuple(replace(t, row=dofs[t.row] if t.moving else hinges[t.row]) for t in body.turns)
    return replace(body, turns=turns, slides=tuple(replace(s, row=dofs[s.row]) for s in body.slides))


def _hold(
    prior: GeometryPrior, tree: Tree, locked: set[int], hinges: dict[int, int]
) -> tuple[GeometryPrior, tuple[str, ...]]:
    """Take out hinge rows that are gone, and parameters whose every raw entry is gone or moves only idle bodies."""
    idle = {k for k in range(len(tree.bodies)) if set(tree.subtree(k)) <= locked}
    kept = [3 * k + c for k in range(len(tree.bodies)) for c in range(3)]
    kept += [prior.n_offset + k for k in hinges]
    matters = torch.tensor(
        [k not in idle for k in range(len(tree.bodies)) for _ in range(3)] + [True] * len(hinges), dtype=torch.bool
    )
    matrix = prior.map[kept]
    free = (matrix[matters] != 0).any(dim=0)
    columns = [k for k in range(len(prior.names)) if free[k]]
    held = [k for k in range(len(prior.names)) if not free[k]]
    reduced = GeometryPrior(
        names=tuple(prior.names[k] for k in columns),
        units=tuple(prior.units[k] for k in columns),
        mean=prior.mean[columns],
        sd=prior.sd[columns],
        map=matrix[:, columns],
        constant=prior.constant[kept] + matrix[:, held] @ prior.mean[held],
        n_hinges=len(hinges),
    )
    return reduced, tuple(prior.names[k] for k in held)
