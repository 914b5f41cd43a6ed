"""The table of joints of a tree, as docs/conventions.md has it."""

import math

from torchid.model.tree import Dof, Tree, Turn


def joint_table(tree: Tree) -> str:
    """Markdown table of the joints: child, parent, axes in order, coordinates, limits [deg]; for any tree."""
    rows = ["| body | parent | axes | coordinates | limits |", "|---|---|---|---|---|"]
    base = tree.dof_names[:6]
    rows.append(f"| {tree.names[0]} | ground | position, rotation vector | {', '.join(base)} | |")
    for body in tree.bodies[1:]:
        moving = [turn for turn in body.turns if turn.moving]
        dofs = [tree.dofs[s.row] for s in body.slides] + [tree.dofs[turn.row] for turn in moving]
        axes = ["slide " + "XYZ"[s.axis] for s in body.slides] + [_axis_text(turn) for turn in moving]
        rows.append(
            f"| {body.name} | {tree.names[body.parent]} | {', '.join(axes) or 'fixed'} | "
            f"{', '.join(d.name for d in dofs)} | {', '.join(_limits_text(d) for d in dofs)} |"
        )
    return "\n".join(rows)


def _axis_text(turn: Turn) -> str:
    return ("-" if turn.sign < 0 else "") + "XYZ"[turn.axis]


def _limits_text(dof: Dof) -> str:
    lower, upper = (math.degrees(v) if dof.unit == "rad" else v for v in (dof.lower, dof.upper))
    return f"{lower:.0f} to {upper:.0f}" if math.isfinite(lower) and math.isfinite(upper) else "free"
