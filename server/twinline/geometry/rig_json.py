"""The rig as versioned JSON text, exact to the last bit and fit to be written by hand.

A rig file is one object. Lengths are millimetres, image quantities pixels; the camera frame is x right, y down, z
forward; the bed frame x along the travel, y across, z up with z = 0 on the bed. Required fields:

``format``, ``version``
    ``"twinline-rig"`` and ``1``.
``name``
    Any text.
``camera``
    ``matrix_px`` (``[[fx, 0, cx], [0, fy, cy], [0, 0, 1]]``), ``size_px`` (``[width, height]``) and, optional, zero
    where absent, ``distortion_k1k2p1p2k3`` (five numbers).
``stripe_runs``
    ``"along-u"`` if a stripe crosses every image column once, ``"along-v"`` if every row.
``sheets``
    One or two objects with ``side`` (``"+u"``, ``"-u"``, ``"+v"``, ``"-v"``: where a rising surface moves the
    stripe) and either ``normal`` (three numbers) and ``offset_mm``, the plane ``normal . p = offset_mm`` in the camera
    frame, or ``baseline_mm`` and ``angle_deg``, distance of the laser from the camera and angle between sheet and
    baseline. A written rig has both; the plane counts, and a readable pair that contradicts it is an error.
``bed_from_camera``
    ``rotation`` (3 x 3) and ``translation_mm``: ``p_bed = rotation p_camera + translation_mm`` at cart position 0.
``travel_mm_per_mm``
    Bed millimetres (x, y, z) per commanded millimetre of the cart.

Optional fields, absent or null where unknown:

``tof``
    ``position_mm``, ``beam``, ``slide_mm_per_mm`` (three numbers each, bed frame), ``gain_mm_per_unit``, ``offset_mm``,
    ``range_mm`` (shortest, longest) and, optional, ``lag_s``.
``noise``
    ``read_dn``, ``electrons_per_dn`` (null: no shot noise), ``speckle``.
``drives``
    ``cart_steps_per_mm``, ``slide_steps_per_mm``.
``covariance``
    ``names`` and ``matrix``, see `twinline.geometry.rig.Covariance`.
``sources``
    For each part of the rig a text that says where it came from.
``evidence``
    Any object; kept as it is.

A file written by hand::

    {"format": "twinline-rig", "version": 1, "name": "my scanner",
     "camera": {"matrix_px": [[1030, 0, 640], [0, 1030, 360], [0, 0, 1]], "size_px": [1280, 720]},
     "stripe_runs": "along-u",
     "sheets": [{"baseline_mm": 246, "angle_deg": 65, "side": "+v"}],
     "bed_from_camera": {"rotation": [[0, 1, 0], [1, 0, 0], [0, 0, -1]], "translation_mm": [0, 0, 430]},
     "travel_mm_per_mm": [1, 0, 0]}
"""

import hashlib
import json
import math
from collections.abc import Callable
from typing import Any, TypeVar, cast

import numpy as np

from twinline.errors import RigError
from twinline.geometry.camera import Camera
from twinline.geometry.json_fields import Fields, parse_object, wrong
from twinline.geometry.noise import NoiseModel
from twinline.geometry.rig import Covariance, Drives, Rig, StripeRuns, TofMount, Transform
from twinline.geometry.sheet import LaserSheet, Side

FORMAT = "twinline-rig"
VERSION = 1

_T = TypeVar("_T")

_VIEW_TOLERANCE = 1e-3
"""Millimetres and degrees by which the readable view may differ from the plane, since people round."""


def rig_to_json(rig: Rig) -> str:
    """JSON text of a rig; `rig_from_json` gives back the same numbers to the last bit.

    Raises
    ------
    RigError
        The evidence or the sources hold something that JSON cannot.
    """
    document = _document(rig)
    for sheet, fields in zip(rig.sheets, document["sheets"], strict=True):
        if math.isfinite(sheet.baseline_mm):
            fields["baseline_mm"] = round(sheet.baseline_mm, 6)
            fields["angle_deg"] = round(math.degrees(sheet.angle_rad), 6)
    if rig.evidence:
        document["evidence"] = dict(rig.evidence)
    return _dump(document, indent=1) + "\n"


def rig_id(rig: Rig) -> str:
    """Twelve hexadecimal digits that name a rig by its content, evidence excluded."""
    return hashlib.sha256(_dump(_document(rig), indent=None).encode()).hexdigest()[:12]


def _dump(document: dict[str, Any], indent: int | None) -> str:
    try:
        return json.dumps(document, indent=indent, sort_keys=indent is None, allow_nan=False)
    except (TypeError, ValueError) as error:
        raise RigError(f"The rig cannot be written as JSON: {error}; correct its evidence or sources.") from error


def _document(rig: Rig) -> dict[str, Any]:
    tof, noise, covariance = rig.tof, rig.noise, rig.covariance
    return {
        "format": FORMAT,
        "version": VERSION,
        "name": rig.name,
        "camera": {
            "matrix_px": rig.camera.matrix.tolist(),
            "distortion_k1k2p1p2k3": rig.camera.distortion.tolist(),
            "size_px": list(rig.camera.size),
        },
        "stripe_runs": rig.stripe_runs,
        "sheets": [
            {"normal": sheet.normal.tolist(), "offset_mm": sheet.offset_mm, "side": sheet.side} for sheet in rig.sheets
        ],
        "bed_from_camera": {
            "rotation": rig.bed_from_camera.rotation.tolist(),
            "translation_mm": rig.bed_from_camera.translation_mm.tolist(),
        },
        "travel_mm_per_mm": rig.travel.tolist(),
        "tof": tof
        and {
            "position_mm": tof.position_mm.tolist(),
            "beam": tof.beam.tolist(),
            "slide_mm_per_mm": tof.slide.tolist(),
            "gain_mm_per_unit": float(tof.gain_mm_per_unit),
            "offset_mm": float(tof.offset_mm),
            "range_mm": [float(tof.range_mm[0]), float(tof.range_mm[1])],
            "lag_s": float(tof.lag_s),
        },
        "noise": noise
        and {
            "read_dn": float(noise.read_dn),
            "electrons_per_dn": float(noise.electrons_per_dn) if math.isfinite(noise.electrons_per_dn) else None,
            "speckle": float(noise.speckle),
        },
        "drives": {
            "cart_steps_per_mm": float(rig.drives.cart_steps_per_mm),
            "slide_steps_per_mm": float(rig.drives.slide_steps_per_mm),
        },
        "covariance": covariance and {"names": list(covariance.names), "matrix": covariance.matrix.tolist()},
        "sources": dict(rig.sources),
    }


def rig_from_json(text: str) -> Rig:
    """Rig from its JSON text.

    Raises
    ------
    RigError
        Naming the field that is missing, unknown, of the wrong type, or impossible.
    """
    top = parse_object(text)
    _check_version(top)
    top.drop_null("tof", "noise", "drives", "covariance", "sources", "evidence")
    name, stripe_runs = top.text("name"), top.text("stripe_runs")
    camera = _camera(top.child("camera"))
    sheets = tuple(_sheet(fields) for fields in top.children("sheets"))
    pose = _pose(top.child("bed_from_camera"))
    travel = top.vector("travel_mm_per_mm", 3)
    tof = _tof(top.child("tof")) if top.has("tof") else None
    noise = _noise(top.child("noise")) if top.has("noise") else None
    drives = _drives(top.child("drives")) if top.has("drives") else Drives()
    covariance = _covariance(top.child("covariance")) if top.has("covariance") else None
    sources = top.child("sources") if top.has("sources") else None
    evidence = top.child("evidence").rest() if top.has("evidence") else {}
    top.finish()
    return Rig(
        name=name,
        camera=camera,
        stripe_runs=cast(StripeRuns, stripe_runs),
        sheets=sheets,
        bed_from_camera=pose,
        travel=travel,
        tof=tof,
        noise=noise,
        drives=drives,
        covariance=covariance,
        sources=_texts(sources) if sources else {},
        evidence=evidence,
    )


def _check_version(top: Fields) -> None:
    if top.text("format") != FORMAT:
        raise RigError(f'The file is not a rig: its field format must be "{FORMAT}".')
    version = top.whole("version")
    if version > VERSION:
        raise RigError(
            f"The rig has version {version}, this program reads up to version {VERSION}: use a newer Twinline."
        )
    if version < 1:
        raise wrong("version", "must be 1 or more", version)


def _texts(fields: Fields) -> dict[str, str]:
    rest = fields.rest()
    for name, value in rest.items():
        if not isinstance(value, str):
            raise wrong(fields.path_of(name), "must be a text", value)
    return cast(dict[str, str], rest)


def _camera(fields: Fields) -> Camera:
    fields.drop_null("distortion_k1k2p1p2k3")
    matrix = fields.matrix("matrix_px", 3, 3)
    distortion = fields.vector("distortion_k1k2p1p2k3", 5) if fields.has("distortion_k1k2p1p2k3") else np.zeros(5)
    size_path = fields.path_of("size_px")
    size = fields.vector("size_px", 2)
    if not (size == np.floor(size)).all():
        raise wrong(size_path, "must be two whole numbers", size.tolist())
    fields.finish()
    return _built(fields, lambda: Camera(matrix, (int(size[0]), int(size[1])), distortion))


def _sheet(fields: Fields) -> LaserSheet:
    fields.drop_null("normal", "offset_mm", "baseline_mm", "angle_deg")
    side = cast(Side, fields.text("side"))
    plane = view = None
    if fields.has("normal") or fields.has("offset_mm"):
        normal, offset_mm = fields.vector("normal", 3), fields.number("offset_mm")
        plane = _built(fields, lambda: LaserSheet(normal, offset_mm, side))
    if fields.has("baseline_mm") or fields.has("angle_deg"):
        baseline_mm, angle_deg = fields.number("baseline_mm"), fields.number("angle_deg")
        view = (baseline_mm, angle_deg)
    fields.finish()
    if plane is None:
        if view is None:
            raise RigError(
                f"The rig lacks the field {fields.path_of('normal')}: a sheet needs normal and offset_mm, or "
                "baseline_mm and angle_deg."
            )
        return _built(fields, lambda: LaserSheet.from_baseline_angle(baseline_mm, math.radians(angle_deg), side))
    if not plane.baseline_mm > 0:
        raise RigError(
            f"The rig's field {fields.path_of('side')} is {side}, but on this plane a rising surface moves the stripe "
            "to the other side: correct the side or the normal."
        )
    _check_view(fields, plane, view)
    return plane


def _check_view(fields: Fields, plane: LaserSheet, view: tuple[float, float] | None) -> None:
    if view is None:
        return
    pairs = zip(("baseline_mm", "angle_deg"), view, (plane.baseline_mm, math.degrees(plane.angle_rad)), strict=True)
    for name, given, actual in pairs:
        if abs(given - actual) > _VIEW_TOLERANCE:
            raise RigError(
                f"The rig's field {fields.path_of(name)} is {given:g}, but normal and offset_mm say {actual:.6g}: "
                "correct it, or give only one of the two descriptions."
            )


def _pose(fields: Fields) -> Transform:
    rotation, translation = fields.matrix("rotation", 3, 3), fields.vector("translation_mm", 3)
    fields.finish()
    return _built(fields, lambda: Transform(rotation, translation))


def _tof(fields: Fields) -> TofMount:
    fields.drop_null("lag_s")
    position, beam, slide = (fields.vector(name, 3) for name in ("position_mm", "beam", "slide_mm_per_mm"))
    gain, offset = fields.number("gain_mm_per_unit"), fields.number("offset_mm")
    shortest, longest = fields.vector("range_mm", 2).tolist()
    lag_s = fields.number("lag_s") if fields.has("lag_s") else 0.0
    fields.finish()
    return _built(fields, lambda: TofMount(position, beam, slide, gain, offset, (shortest, longest), lag_s))


def _noise(fields: Fields) -> NoiseModel:
    fields.drop_null("electrons_per_dn")
    read_dn, speckle = fields.number("read_dn"), fields.number("speckle")
    electrons = fields.number("electrons_per_dn") if fields.has("electrons_per_dn") else math.inf
    fields.finish()
    return _built(fields, lambda: NoiseModel(read_dn, electrons, speckle))


def _drives(fields: Fields) -> Drives:
    cart, slide = fields.number("cart_steps_per_mm"), fields.number("slide_steps_per_mm")
    fields.finish()
    return _built(fields, lambda: Drives(cart, slide))


def _covariance(fields: Fields) -> Covariance:
    names = fields.texts("names")
    matrix = fields.matrix("matrix", len(names), len(names))
    fields.finish()
    return _built(fields, lambda: Covariance(names, matrix))


def _built(fields: Fields, build: Callable[[], _T]) -> _T:
    try:
        return build()
    except RigError as error:
        raise RigError(f"The rig's field {fields.path} is impossible: {error.detail}") from error
