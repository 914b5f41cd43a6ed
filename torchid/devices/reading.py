"""A device from a YAML sheet, a URDF file or the built-in library."""

import json
from collections import Counter
from collections.abc import Mapping
from difflib import get_close_matches
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import BaseModel, ValidationError

from torchid.devices.device import Device, Part, SheetValue
from torchid.devices.elements import element_of, fault, number, vector
from torchid.devices.sheet import AttachedLink, DeviceSheet, ElementSheet, MatrixWithSd, PartSheet
from torchid.errors import ConfigError
from torchid.model.mechanics import phi_to_centre, rpy_to_matrix
from torchid.model.urdf import read_urdf
from torchid.storage.documents import read_document

SUFFIXES = (".yaml", ".yml", ".json")
Attachments = Mapping[str, str | AttachedLink]
"""Link of a URDF file: segment, or its pose on one."""
_SECTIONS = {"parts": PartSheet, "elements": ElementSheet, "attach": AttachedLink}


def library() -> tuple[str, ...]:
    """Return the names of the built-in devices."""
    found = files("torchid.devices").joinpath("library").iterdir()
    return tuple(sorted(one.name.removesuffix(".yaml") for one in found if one.name.endswith(".yaml")))


def load_device(source: Path | str, attachments: Attachments | None = None) -> Device:
    """Read a device.

    Args:
        source: path of a YAML or JSON sheet or of a URDF file, or a name of the built-in library.
        attachments: of the links of a URDF file to segments; absent, every link is on the segment of its name.

    Raises:
        ConfigError: ``device.*`` with the key at fault, and the nearest known one where it is misspelt.
        InputError: the URDF file cannot be read.
    """
    path = Path(source)
    if path.suffix.lower() == ".urdf":
        return Device(path.stem, tuple(attached_parts(path, attachments or {})))
    if path.suffix.lower() not in SUFFIXES:
        known = library()
        if str(source) not in known:
            near = get_close_matches(str(source), known, n=1, cutoff=0.4)
            remedy = f"Did you mean '{near[0]}'?" if near else f"Known: {', '.join(known)}; or a path to YAML or URDF."
            raise ConfigError("device.unknown_name", "no such device", found=str(source), remedy=remedy)
        path = Path(str(files("torchid.devices").joinpath("library", f"{source}.yaml")))
    if not path.is_file():
        raise ConfigError("device.missing_file", "no such file", source=path, remedy="Correct the path.")
    return device_of(read_document(path), path)


def device_of(document: Any, path: Path) -> Device:
    """Make a device of a sheet's content.

    Args:
        document: nested mappings and lists.
        path: the file they come from, from whose folder relative paths start.

    Raises:
        ConfigError: ``device.*``.
    """
    try:
        sheet = DeviceSheet.model_validate_json(json.dumps(document))
    except ValidationError as error:
        raise _explain(error, document, path) from error
    parts = [_part(one, k, path) for k, one in enumerate(sheet.parts)]
    if sheet.urdf is not None:
        parts += attached_parts(path.parent / sheet.urdf, sheet.attach)
    elements = [element_of(one, k, path) for k, one in enumerate(sheet.elements)]
    _refuse_twice([one.name for one in parts], "parts", path)
    _refuse_twice([one.name for one in elements], "elements", path)
    total = None if sheet.mass_kg is None else number(sheet.mass_kg)
    return Device(sheet.name, tuple(parts), tuple(elements), sheet.sources, total)


def _refuse_twice(names: list[str], where: str, path: Path) -> None:
    twice = [name for name, count in Counter(names).items() if count > 1]
    if twice:
        remedy = "Give every one a `name:` of its own."
        raise fault("name_twice", "a name stands twice", path, where, ", ".join(twice), remedy=remedy)


def _part(sheet: PartSheet, k: int, path: Path) -> Part:
    mass, com = number(sheet.mass_kg), vector(sheet.com_m)
    if mass is not None and not mass.value >= 0.0:
        raise fault("mass", "no mass is negative", path, f"parts.{k}.mass_kg", f"{mass.value:g}", remedy="Correct it.")
    inertia = None if sheet.inertia_kgm2 == "unknown" else _inertia(sheet.inertia_kgm2)
    return Part(sheet.name or sheet.segment, sheet.segment, mass, com, inertia)


def _inertia(text: Any) -> tuple[SheetValue, SheetValue, SheetValue, SheetValue, SheetValue, SheetValue]:
    matrix: Any = text.value if isinstance(text, MatrixWithSd) else text
    sd = text.sd if isinstance(text, MatrixWithSd) else 0.0
    if isinstance(matrix[0], tuple):
        (xx, xy, xz), (_, yy, yz), (_, _, zz) = matrix
    else:
        (xx, yy, zz), xy, xz, yz = matrix, 0.0, 0.0, 0.0
    a, b, c, d, e, f = (SheetValue(value, sd) for value in (xx, xy, yy, xz, yz, zz))
    return a, b, c, d, e, f


def _explain(error: ValidationError, document: Any, path: Path) -> ConfigError:
    """Say the fault that lies deepest: of a union, the member that was meant."""
    detail = max(error.errors(include_url=False), key=lambda one: len(_place(one["loc"], document)))
    place = _place(detail["loc"], document)
    where = ".".join(map(str, place))
    if detail["type"] == "extra_forbidden":
        near = get_close_matches(str(place[-1]).lower(), _keys(place), n=1, cutoff=0.5)
        remedy = f"Did you mean '{near[0]}'?" if near else f"Known here: {', '.join(_keys(place))}."
        return fault("unknown_key", "unknown key", path, where, remedy=remedy)
    if detail["type"] == "missing":
        return fault("missing_key", "this key is required", path, where, remedy=f"Add {detail['loc'][-1]}: .")
    message = detail["msg"].replace("Input should be", "must be")
    remedy = "Numbers are written x, {value: x, sd: s} or unknown; see docs/devices.md."
    return fault("value", message, path, where, repr(detail.get("input"))[:80], remedy=remedy)


def _place(steps: tuple[str | int, ...], document: Any) -> tuple[str | int, ...]:
    """Keep the steps that are in the document: pydantic mixes names of union members in between."""
    place: list[str | int] = []
    for k, step in enumerate(steps):
        inside = isinstance(document, dict) and step in document
        inside |= isinstance(document, list) and isinstance(step, int) and step < len(document)
        if inside:
            document = document[step]  # pyright: ignore[reportArgumentType, reportCallIssue]
        elif k < len(steps) - 1:
            continue
        place.append(step)
    return tuple(place)


def _keys(place: tuple[str | int, ...]) -> list[str]:
    """Return the keys that are known where a key stands."""
    section: type[BaseModel] = DeviceSheet
    for step in place[:-1]:
        if step in ("profile", "sensor", "via"):
            annotation = section.model_fields[str(step)].annotation
            members = getattr(annotation, "__args__", ())
            section = next(one for one in members if isinstance(one, type) and issubclass(one, BaseModel))
        else:
            section = _SECTIONS.get(str(step), section)
    return list(section.model_fields)


def attached_parts(path: Path, attachments: Mapping[str, str | AttachedLink]) -> list[Part]:
    """Read the links of a URDF file as parts of segments; links behind fixed joints are part of their parents.

    Args:
        attachments: link: segment whose axes and origin are the link's, or the link's pose on one. Without any, the
            links carry the names of segments.

    Raises:
        ConfigError: ``device.attachment`` where a link is on no segment or an attachment has no link.
        InputError: the file cannot be read.
    """
    model, _ = read_urdf(path)
    names = model.tree.names
    where = dict(attachments) or dict(zip(names, names, strict=True))
    for name in where:
        if name not in names:
            near = get_close_matches(name, names, n=1, cutoff=0.5)
            remedy = f"Did you mean '{near[0]}'?" if near else f"Links that move by themselves: {', '.join(names)}."
            raise fault("attachment", "no such link", path, f"attach.{name}", remedy=remedy)
    lost = [name for name in names if name not in where]
    if lost:
        remedy = "List under `attach` the segment of every link that moves by itself."
        raise fault("attachment", "a link is on no segment", path, "attach", ", ".join(lost), remedy=remedy)
    phi = model.inertia.mean.numpy()
    return [_part_of_link(name, where[name], phi[k]) for k, name in enumerate(names)]


def _part_of_link(name: str, attachment: str | AttachedLink, phi: np.ndarray) -> Part:
    at = attachment if isinstance(attachment, AttachedLink) else AttachedLink(segment=attachment)
    R = rpy_to_matrix(*at.rpy)
    mass, centre, inertia = phi_to_centre(phi, name)
    x, y, z = (SheetValue(float(v)) for v in np.array(at.xyz) + R @ centre)
    turned = R @ inertia @ R.T
    a, b, c, d, e, f = (SheetValue(float(turned[i, j])) for i, j in ((0, 0), (0, 1), (1, 1), (0, 2), (1, 2), (2, 2)))
    return Part(name, at.segment, SheetValue(mass), (x, y, z), (a, b, c, d, e, f))
