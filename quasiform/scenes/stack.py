"""The plies of a scene: which sheets they become, and which of them can touch each other.

Plies that are joined and identical are one sheet: n membranes, n weights, and the bending

    n B + Σ C t z²,  z the height of each mean surface over that of the stack,

C the fibre modulus of warp or weft: 2 B + C t³/2 for two plies.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import shapely

from ..checks import InputError
from ..energy.plies import PlyContact, PlyFriction
from ..energy.stitches import Stitches
from ..energy.term import Term
from ..fabric import Fabric, fabric_of
from ..model import Model
from ..net.slits import as_lines
from .scene_parts import SceneFile, Seam

FRICTION = 0.3  # of ply on ply, where the scene gives none (assumed: no public value was found)
THREAD = 10.0  # N/mm, stiffness of a stitch where the scene gives none (assumed)
MOST = 12  # plies
EPS = 1e-6  # of an area: what is smaller is round-off


@dataclass(frozen=True, eq=False)
class Layer:
    """What becomes one sheet: a ply, or several that are joined."""

    name: str
    outline: shapely.Polygon  # flat, mm
    orientation: float  # of the warp, degrees
    fabric: Fabric
    friction: float  # with the layer above it
    plies: tuple[int, ...]  # their numbers in the scene, from 1 on; none: the scene has one sheet
    slits: tuple[np.ndarray, ...] = ()  # lines (k, 2) along which it is cut, mm
    darts: tuple[shapely.Polygon, ...] = ()  # that are cut out of the outline
    stitches: tuple[Seam, ...] = ()  # to the layer above it


def layers_of(
    file: SceneFile, fabric: Fabric, orientation: float, outline: shapely.Polygon
) -> list[Layer]:
    """Layers of a scene, from the punch down; InputError for plies that cannot be formed."""
    if not file.plies:
        slits, darts = file.blank.cuts() if file.blank else ((), ())
        return [Layer("sheet", outline, orientation, fabric, 0.0, (), slits, darts)]
    _check_possible(file)
    found: list[Layer] = []
    for i, ply in enumerate(file.plies, 1):
        own = ply.blank.polygon if ply.blank else outline
        own = shapely.affinity.translate(own, *ply.offset)
        cuts = (ply.blank or file.blank).cuts(ply.offset)
        mu = FRICTION if ply.friction is None else ply.friction
        angle = orientation + ply.orientation
        try:
            law = fabric_of(ply.law or fabric)
        except InputError as error:
            raise InputError(f"[plies {i}] {error}") from error
        if law.slip is not None:
            raise InputError(f"[plies {i}] slip of the rovings is not possible with several plies")
        layer = Layer("", own, angle, law, mu, (i,), *cuts, ply.stitches)
        found.append(_joined(found.pop(), layer) if ply.joined else layer)
        if len(found) > 1 and not _overlap(found[-1].outline, found[-2].outline):
            raise InputError(f"[plies {i}] does not overlap the ply above it")
    if len(found) == 1:
        return [replace(found[0], name="sheet")]
    return [replace(layer, name=f"ply {k}") for k, layer in enumerate(found, 1)]


def _check_possible(file: SceneFile) -> None:
    """Refuse (InputError) what is not possible with plies."""
    if len(file.plies) > MOST:
        raise InputError(f"at most {MOST} plies, got {len(file.plies)}")
    first = file.plies[0]
    for key, given in (
        ("joined", first.joined),
        ("friction", first.friction is not None),
        ("stitches", first.stitches),
    ):
        if given:
            raise InputError(f"[plies 1] {key}: there is no ply above it")
    for i, ply in enumerate(file.plies, 1):
        if ply.joined and ply.stitches:
            raise InputError(f"[plies {i}] joined plies have no stitches of their own")
    if isinstance(file.mesh, Path) or file.mesh != "fibre":
        raise InputError("[[plies]] need mesh = 'fibre'")


def _joined(above: Layer, layer: Layer) -> Layer:
    """One layer of two that are joined; InputError if they differ."""
    same = above.fabric == joined(layer.fabric, len(above.plies))
    turned = (layer.orientation - above.orientation) % 360.0
    differ = layer.outline.symmetric_difference(above.outline).area > EPS * layer.outline.area
    cut = not as_lines(layer.slits).equals(as_lines(above.slits))
    if not same or turned or differ or cut:
        what = "fabric" if not same else "orientation" if turned else "outline"
        what = "slit" if what == "outline" and not differ else what
        raise InputError(
            f"[plies {layer.plies[0]}] joined: it has another {what} than the ply above it; only "
            "identical plies can be joined"
        )
    plies = above.plies + layer.plies
    return replace(above, fabric=joined(layer.fabric, len(plies)), plies=plies)


def joined(fabric: Fabric, count: int) -> Fabric:
    """Fabric of identical plies that are joined, as one sheet."""
    if count == 1:
        return fabric
    if fabric.moment_warp or fabric.moment_weft:
        raise InputError("joined plies need a constant bending stiffness, without a moment curve")
    t = fabric.thickness
    z = t * (np.arange(count) - 0.5 * (count - 1))
    bending = {
        f"bending_{family}": count * getattr(fabric, f"bending_{family}")
        + 4.0 * float(getattr(fabric, family).stiffness(np.ones(1), 1.0)[0]) * t * float(z @ z)
        for family in ("warp", "weft")
    }
    more = {"thickness": count * t, "areal_weight": count * fabric.areal_weight}
    return replace(fabric, name=f"{count} x {fabric.name}, joined", **bending, **more)


def _overlap(a: shapely.Polygon, b: shapely.Polygon) -> bool:
    return a.intersection(b).area > EPS * min(a.area, b.area)


def seen(layer: Layer, over: Sequence[Layer]) -> bool:
    """Whether a part of a layer is not covered by the others."""
    free = layer.outline.difference(shapely.union_all([other.outline for other in over]))
    return free.area > EPS * layer.outline.area


def _at_an_angle(layers: Sequence[Layer]) -> bool:
    # round-off below a right angle is none
    return len({round(layer.orientation % 90.0, 6) % 90.0 for layer in layers}) > 1


def heights(layers: Sequence[Layer]) -> list[float]:
    """Heights of the mean surfaces over the die, mm."""
    t = np.array([layer.fabric.thickness for layer in layers])
    return (t.sum() - np.cumsum(t) + 0.5 * t).tolist()


def outline_of(layers: Sequence[Layer]) -> shapely.Polygon:
    """Outline of all plies seen from above."""
    whole = shapely.union_all([layer.outline for layer in layers])
    return layers[0].outline if len(layers) == 1 else whole


def meets(layers: Sequence[Layer], k: int, role: str) -> bool:
    """Whether layer k can touch a tool of a role: no other plies keep it from it.

    Plies at an angle to each other draw in differently, and their rims come free.
    """
    between = layers[:k] if role != "die" else layers[k + 1 :]
    return seen(layers[k], between) or _at_an_angle([layers[k], *between])


def between_plies(model: Model, layers: Sequence[Layer]) -> list[Term]:
    """Contact and friction of the plies that can touch each other."""
    contacts: list[PlyContact] = []
    frictions: list[Term] = []
    left_out, coefficients = [], []
    for i in range(len(layers)):
        for k in range(i + 1, len(layers)):
            both = layers[i].outline.intersection(layers[k].outline)
            if both.area <= EPS * layers[k].outline.area or (
                k > i + 1
                and not seen(replace(layers[i], outline=both), layers[i + 1 : k])
                and not _at_an_angle(layers[i : k + 1])
            ):
                left_out.append(f"{layers[i].name} with {layers[k].name}")
                continue
            above, below, mu = model.sheets[i], model.sheets[k], layers[k].friction
            pair = PlyContact(above, below, True), PlyContact(below, above, False)
            contacts += pair
            frictions += [PlyFriction(contact, mu) for contact in pair if mu]
            coefficients.append(f"{mu:g} between {layers[i].name} and {layers[k].name}")
    why = f"nodes of each ply against the surface of the other; friction {', '.join(coefficients)}"
    model.description.append(("contact between plies", why))
    if left_out:
        why = "other plies lie between, or they do not overlap"
        model.description.append((f"contact left out: {', '.join(left_out)}", why))
    return [*contacts, *frictions, *_stitched(model, layers)]


def _stitched(model: Model, layers: Sequence[Layer]) -> list[Stitches]:
    """Stitches of each layer to the one above it; InputError for one outside of a ply."""
    found = []
    for k, layer in enumerate(layers):
        if not layer.stitches:
            continue
        above, below = model.sheets[k - 1], model.sheets[k]
        near = 0.5 * (above.fabric.thickness + below.fabric.thickness)
        rows = [
            (place, THREAD if seam.stiffness is None else seam.stiffness, near + seam.slack)
            for seam in layer.stitches
            for place in seam.places
        ]
        points, *threads = map(np.array, zip(*rows, strict=True))
        try:
            found.append(Stitches(above, below, points, *threads))
        except InputError as error:
            raise InputError(f"[plies {layer.plies[0]}] {error}") from error
        what = f"stitches between {above.name} and {below.name}"
        model.description.append((what, f"{len(points)} threads, taut from {near:.3g} mm on"))
    return found


def described(layers: Sequence[Layer]) -> list[tuple[str, str]]:
    """Lines of the model about its plies; none for a scene without."""
    if not layers[0].plies:
        return []
    words = []
    for layer in layers:
        numbers = " and ".join(map(str, layer.plies))
        joint = " are one sheet," if len(layer.plies) > 1 else ""
        words.append(f"{numbers}{joint} at {layer.orientation:g}°, {layer.fabric.name}")
    lines = [("plies from the punch down", "; ".join(words))]
    if _at_an_angle(layers):
        why = "warp and weft of the plies do not run alike: several times slower, may stop early"
        lines.append(("plies at an angle to each other", why))
    return lines


def cuts(layers: Sequence[Layer]) -> list[tuple[str, str]]:
    """Lines of the model about slits; none without."""
    words = []
    for layer in layers:
        if layer.slits:
            at = f" in {layer.name}" * bool(layer.plies)
            words.append(f"{len(layer.slits)}{at}, {as_lines(layer.slits).length:.4g} mm long")
    return [("slits", f"{'; '.join(words)}: both edges part, without contact")] if words else []


def written(layers: Sequence[Layer]) -> list[dict[str, Any]]:
    """What `summary.json` says of the sheets of a stack."""
    return [
        {
            "plies": list(layer.plies),
            "orientation": layer.orientation,
            "fabric": asdict(layer.fabric),
            "thickness": layer.fabric.thickness,
        }
        for layer in layers
    ]


def assumed_between(file: SceneFile) -> list[str]:
    """Dotted names of numbers between plies that the scene does not give."""
    found = []
    for i, ply in enumerate(file.plies[1:], 2):
        if ply.friction is None and not ply.joined:
            found.append(f"plies {i}.friction")
        for k, seam in enumerate(ply.stitches, 1):
            if seam.stiffness is None:
                found.append(f"plies {i}.stitches {k}.stiffness")
    return found


def as_tables(plies: Sequence[Any]) -> list[dict[str, Any]]:
    """Tables of plies, each given as a table or as an angle in degrees."""
    tables = []
    for ply in plies:
        table = dict(ply) if hasattr(ply, "keys") else {"orientation": ply}
        if isinstance(table.get("fabric"), Fabric):
            table["fabric"] = table["fabric"].written()
        tables.append(table)
    return tables
