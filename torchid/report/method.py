"""How the results were computed, and what they rest on."""

from collections.abc import Sequence

from torchid.config import dump_config
from torchid.report.blocks import Block, Details, Items, Listing, Section, Table
from torchid.session import Outcome
from torchid.session.tables import identified_table
from torchid.session.unseen import hold_unseen
from torchid.storage.provenance import StageTime, versions
from torchid.wording import clean, listing, number, percent, plural, scientific, segment

METHODS = (
    "Equations linear in the inertial parameters: Atkeson, An & Hollerbach, Int J Robotics Res 5(3), 1986",
    "Identification from base rows: Ayusawa, Venture & Nakamura, Int J Robotics Res 33(3), 2014",
    "Physically consistent inertia by linear matrix inequalities: Wensing, Kim & Slotine, IEEE RA-L 3(1), 2018; "
    "Traversaro et al., IROS 2016",
    "Base parameters: Gautier, J Robotic Systems 8(4), 1991",
    "Weights by evidence: MacKay, Neural Computation 4(3), 1992",
)

SKIN = (
    "Skin slides by {} mm with a radian of a joint near it, in the root mean square over markers; ± holds what that "
    "leaves open."
)
"""Wording. Above the table of parameters."""
STAGES = (
    ("read", "Reading the recordings"),
    ("geometry", "Fit of the geometry"),
    ("motion_", "Following the markers, identified geometry"),
    ("scaled_", "Following the markers, scaled template"),
    ("scaled", "Scaling the template"),
    ("follow", "Filter, contacts and wrenches"),
    ("inertia", "Fit of the inertia"),
    ("residuals", "Residuals step by step"),
    ("diagnosis", "Diagnosis"),
    ("witnesses", "Model-free checks"),
    ("torques", "Joint torques"),
    ("consistent", "Motion that obeys its forces"),
)
"""Beginnings of the names of stages, and what they are."""


def method_section(outcome: Outcome) -> Section:
    """The section on computation."""
    blocks: list[Block] = [_geometry(outcome)]
    if outcome.identified is not None:
        blocks += [_inertia(outcome), _certificate(outcome), *_base(outcome)]
    blocks += [
        Details("Standard deviations of the named geometric parameters", (_parameters(outcome),)),
        Details("Settings: the resolved config", (Listing(clean_lines(dump_config(outcome.config))),)),
        *_times(outcome),
        Details("Versions", (Table("", ("Software", "Version"), tuple(versions().items()), text=2),)),
        Items(tuple(clean(source, 400) for source in (*outcome.fit.model.sources, *METHODS))),
    ]
    return Section("method", "How it was computed", _finding(outcome), tuple(blocks))


def clean_lines(text: str) -> str:
    """Text of several lines without control characters."""
    return "\n".join(clean(line, 2000) for line in text.splitlines())


def _finding(outcome: Outcome) -> str:
    fit = outcome.fit
    said = f"The geometry was fitted with the {fit.options.solver} solver"
    if fit.solution is not None:
        ended = "converged" if fit.solution.converged else "did NOT converge"
        said += f", which {ended} after {plural(fit.solution.iterations, 'iteration')} in its last pass"
    if outcome.identified is None:
        return f"{said}; no inertia was identified."
    found = outcome.identified.fit
    return (
        f"{said}; the forces determine {found.rank} of {found.phi.numel()} inertial parameters or combinations of "
        f"them, and the result was {found.status.value.replace('_', ' ')} by its certificate."
    )


def _geometry(outcome: Outcome) -> Table:
    fit = outcome.fit
    sigma = 1e3 * fit.sigma
    rows = [
        ("Solver", fit.options.solver),
        ("Iterations, converged", "–" if fit.solution is None
         else f"{fit.solution.iterations}, {'yes' if fit.solution.converged else 'no'}"),
        ("Free parameters", f"{len(fit.prior.mean)} of geometry, {fit.place.numel()} of marker places"),
        ("Marker scatter sigma", f"median {number(sigma.median(), 2)} mm per coordinate, "
                                 f"largest {number(sigma.max(), 2)} mm"),
        ("Robust loss", "off" if fit.options.robust is None else f"on, from {number(fit.options.robust)} sigma"),
        ("Left and right", "tied" if fit.options.symmetry == "tied" else "independent"),
    ]  # fmt: skip
    return Table("Geometry", ("", ""), tuple(rows), text=2, wrap=True)


def _inertia(outcome: Outcome) -> Table:
    assert outcome.identified is not None
    fit, rows = outcome.identified.fit, outcome.identified.rows
    config = outcome.config.inertia
    asked, _ = hold_unseen(config, outcome.prior, outcome.fit)
    found = [
        ("Solver", f"{fit.certificate.solver}, {plural(fit.certificate.iterations, 'iteration')}"),
        ("Data", f"{rows} whitened rows from {plural(len(outcome.session.fit('inertia')), 'fit trial')}"),
        ("Weight of the data, omega_1", scientific(fit.omega_1)),
        ("Weight of the prior, omega_2", f"{scientific(fit.omega_2)} (chosen: {asked.prior_weight})"),
        ("Prior", "tables" if outcome.config.subject.people is None else f"tables as people of a cohort changed them "
                  f"({clean(str(outcome.config.subject.people), 200)})"),
        ("Rank", f"{fit.rank} of {fit.phi.numel()} parameters"),
        ("Base parameters", "not worked out" if fit.base is None else str(len(fit.base.names))),
        ("Physical consistency", "every segment's pseudo-inertia positive definite" if config.lmi else "not enforced"),
        ("Log evidence", f"{number(fit.log_evidence)} nat"),
    ]  # fmt: skip
    return Table("Inertia", ("", ""), tuple(found), text=2, wrap=True)


def _certificate(outcome: Outcome) -> Table:
    """Recomputed figures, what they mean and what was asked of them."""
    assert outcome.identified is not None
    certificate, low = identified_table(outcome)["certificate"], outcome.identified.fit.certificate
    conflict, optimality = certificate.conflict, certificate.optimality
    smallest = int(low.smallest_eigenvalue.argmin())
    least, active = segment(outcome.identified.fit.names[smallest]), [segment(name) for name in certificate.active]
    rows = (
        ("Constraint violation", scientific(optimality.primal), "relative; 0 is exact"),
        ("Stationarity", scientific(optimality.dual), "posterior standard deviations still to go"),
        ("Duality gap", scientific(optimality.gap), "relative to the objective"),
        ("Smallest eigenvalue", scientific(low.smallest_eigenvalue[smallest]),
         f"of a pseudo-inertia over its trace, {least}; positive is physical"),
        ("Constraints active", listing(active), "segments held back only by physics"),
        ("Condition", number(certificate.condition), "of the regressor with unit columns, without its null directions"),
        ("Wrench explained", percent(certificate.explained, 2), "share of the squared wrench"),
        ("Total mass the data ask for", f"{number(conflict.mass_ratio, 3)} of the prior's",
         f"{number(conflict.mass_z)} standard deviations away"),
        ("Agreement with the prior", f"chi-square {number(conflict.chi_square)} at {conflict.dof} degrees of freedom",
         f"p = {scientific(conflict.p_value)}; small: data and tables contradict each other beyond their scatter"),
    )  # fmt: skip
    return Table(
        "Certificate, recomputed from the equations after the solver",
        ("Figure", "Value", "Meaning"),
        rows,
        text=3,
        wrap=True,
    )


def _base(outcome: Outcome) -> list[Block]:
    base = identified_table(outcome)["base_parameters"]
    if base is None:
        return []
    rows = tuple((clean(entry["name"], 400), number(entry["value"], 4), number(entry["sd"], 4)) for entry in base)
    table = Table(
        "Combinations that the data determine; masses in kg, mc in kg m, I in kg m²",
        ("Combination", "Value", "±"),
        rows,
        wrap=True,
    )
    return [Details(f"{plural(len(rows), 'base parameter')} with values", (table,))]


def _times(outcome: Outcome) -> list[Block]:
    """What each stage cost; the trials' shares of a stage are added up."""
    costs = list(outcome.times.values())
    if not costs:
        return []
    stages = dict.fromkeys(_stage(name) for name in outcome.times)
    rows = [_cost(words, [c for n, c in outcome.times.items() if _stage(n) == words]) for words in stages]
    rows.append(_cost("Together", costs))
    reused = sum(cost.reused for cost in costs)
    caption = "Seconds, without the writing of files and of this page"
    if reused:
        caption += f"; {plural(reused, 'result')} taken from an earlier run, with what they cost then"
    table = Table(caption, ("Stage", "Clock", "All processors"), tuple(rows), strong=frozenset({len(rows) - 1}))
    return [Details(f"Time: {rows[-1][1]} s on the clock", (table,))]


def _stage(name: str) -> str:
    return next((words for start, words in STAGES if name.startswith(start)), clean(name))


def _cost(words: str, costs: Sequence[StageTime]) -> tuple[str, str, str]:
    return words, number(sum(cost.seconds for cost in costs)), number(sum(cost.cpu_seconds for cost in costs))


def _parameters(outcome: Outcome) -> Table:
    fit = outcome.fit
    sd = fit.xi * float("nan") if fit.uncertainty is None else fit.uncertainty.sd
    rows = []
    for k, (name, unit) in enumerate(zip(fit.prior.names, fit.prior.units, strict=True)):
        factor, shown = (1e3, "mm") if unit == "m" else (57.29577951308232, "°") if unit == "rad" else (1.0, unit)
        digits = [number(x, 1, factor) for x in (fit.xi[k], sd[k], fit.prior.mean[k], fit.prior.sd[k])]
        rows.append((clean(name), shown, *digits))
    slides = 0.0 if fit.uncertainty is None else fit.uncertainty.skin_m_rad
    caption = SKIN.format(number(slides, 1, 1e3)) if slides else ""
    return Table(caption, ("Parameter", "Unit", "Identified", "±", "Prior", "±"), tuple(rows), text=2, wrap=True)
