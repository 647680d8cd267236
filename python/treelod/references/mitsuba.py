"""
Coverage and colour by mitsuba 3, variant ``scalar_rgb``.

Scenes are moved to the origin and scaled up: a ray that has passed a mask goes on 9e-5 (1 + its
largest coordinate) behind it, and misses what lies in between. On an aspen of 102 m, at its own
coordinates, this takes 0.0010 from the mean alpha of a slice; moved and scaled, 0.0001. Embree
agrees with us there to 0.0001.

Alpha comes from the path integrator with hidden emitters, which alone honours masks; colour, of
plants without cut-outs, from the albedo of two-sided diffuse surfaces that bear our vertex colours.
`run` is what the child process does; `draw` asks for it.
"""

from __future__ import annotations

import functools
import time
from typing import TYPE_CHECKING, Any

import numpy as np

from treelod.color import quantize
from treelod.references.cards import parted
from treelod.references.runner import reference
from treelod.references.texels import bilinear_alpha
from treelod.references.views import bands

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import NDArray

    from treelod.references.soup import Soup

__all__ = ["Picture", "banded", "can_be_masked", "draw", "run"]

_SIZE = 1000.0
"""Diagonal of a scene as mitsuba sees it: so large that the 1 in its step does not count."""

_MASK_SIDE = 4096
"""
Largest side of a mask, unless the texture's own is larger.
"""

_MASK_FACTOR = 16
"""
Cells a texel, at most: mitsuba reads the nearest cell, so bilinear alpha is compared with the
cutoff on a grid finer than the texture.
"""

_SAMPLES_A_BAND = 1 << 24
"""Some ten seconds of one processor: what a run that is stopped may lose."""

Picture = dict[str, Any]
"""
One picture to draw: ``soup`` (which of those given), ``view`` (from
`treelod.references.views.camera_settings`), ``spp``, ``seed``, ``sampler`` ('independent' or
'multijitter') and ``quantity``: 'alpha'; 'color', that of the soup as it is; or 'sunlit', the
soup's colours as diffuse surfaces under a sun of irradiance pi in direction ``sun``. If wanted also
``rows``, the first row and the one after the last, and ``side_parts``, into which sides of cut-out
triangles are parted for coverage (`treelod.references.cards`).
"""


def can_be_masked(soup: Soup) -> bool:
    """
    Say whether mitsuba can be given a soup's opacities.

    Besides textures it takes one number a material, and it wraps both axes of a texture alike.

    Parameters
    ----------
    soup : Soup
        Any.

    Returns
    -------
    bool
    """
    for index in np.unique(soup.material_ids):
        material = soup.materials[index]
        if material.alpha_mode == "opaque":
            continue
        if len(np.unique(soup.opacity[soup.material_ids == index])) > 1:
            return False
        if material.texture is not None and material.wrap[0] != material.wrap[1]:
            return False
    return True


def draw(
    soups: Sequence[Soup],
    pictures: Sequence[Picture],
    *,
    cached: bool = True,
    threads: int | None = None,
) -> tuple[list[NDArray[np.float32]], NDArray[np.float64]]:
    """
    Draw pictures with mitsuba.

    Parameters
    ----------
    soups : sequence of Soup
        Of one plant.
    pictures : sequence of Picture
        What to draw.
    cached : bool, default True
        As in `treelod.references.runner.reference`.
    threads : int, optional
        That mitsuba draws with. Default: all cores.

    Returns
    -------
    pictures : list of ndarray of shape (H, W) or (H, W, 3), dtype float32
        Alpha, or premultiplied linear colour; of the rows that are stated.
    secs : ndarray of shape (P,)
        Seconds that rendering each took, without loading its scene.

    Raises
    ------
    ImportError, ReferenceFailedError
        As `treelod.references.runner.reference`.
    ValueError
        If a material that is cut out or blended has several opacities, or wraps its texture in two
        ways.
    """
    arrays: dict[str, NDArray[Any]] = {}
    center, scale = _placing(soups)
    facts: list[dict[str, Any]] = [
        {
            "wrap": list(material.wrap),
            "alpha_mode": material.alpha_mode,
            "alpha_cutoff": material.alpha_cutoff,
        }
        for material in soups[0].materials
    ]
    for number, soup in enumerate(soups):
        if not can_be_masked(soup):
            msg = "mitsuba takes one opacity and one kind of wrap a material"
            raise ValueError(msg)
        used = np.unique(soup.material_ids)
        placed = (soup.corners - center) * scale
        arrays[f"corners_{number}"] = placed.astype(np.float32)
        arrays[f"uvs_{number}"] = soup.uvs.astype(np.float32)
        arrays[f"material_ids_{number}"] = soup.material_ids
        if any(p["quantity"] != "alpha" and p["soup"] == number for p in pictures):
            arrays[f"front_{number}"] = soup.front.astype(np.float32)
            arrays[f"back_{number}"] = soup.back.astype(np.float32)
        for index in used:
            material = soup.materials[index]
            facts[index]["opacity"] = float(soup.opacity[soup.material_ids == index].flat[0])
            if material.texture is not None and material.alpha_mode != "opaque":
                arrays[f"alpha_{index}"] = material.texture[..., 3]
    placed_pictures = [
        {**picture, "view": _placed(picture["view"], center, scale)} for picture in pictures
    ]
    settings: dict[str, Any] = {"pictures": placed_pictures, "materials": facts}
    if threads is not None:
        settings["threads"] = threads
    made = reference("mitsuba", arrays, settings, cached=cached)
    return [made[f"picture_{index}"] for index in range(len(pictures))], made["secs"]


def banded(soup: Soup, picture: Picture) -> list[Callable[[], NDArray[np.float32]]]:
    """
    Part a picture into calls that draw it, for `treelod.references.runner.in_parallel`.

    Parameters
    ----------
    soup : Soup
        What to draw.
    picture : Picture
        How; of soup 0.

    Returns
    -------
    list of callable
        Each draws a band of rows, from the top, with one thread: two threads of a scalar variant
        are often no faster than one, two processes are.
    """

    def draw_rows(rows: tuple[int, int]) -> NDArray[np.float32]:
        return draw([soup], [{**picture, "rows": list(rows)}], threads=1)[0][0]

    parts = bands(tuple(picture["view"]["size"]), picture["spp"], _SAMPLES_A_BAND)
    return [functools.partial(draw_rows, rows) for rows in parts]


def _placing(soups: Sequence[Soup]) -> tuple[NDArray[np.float64], float]:
    """Middle of all triangles, and what makes them `_SIZE` large; a point stays as it is."""
    boxes = [
        bound(soup.corners, axis=(0, 1))
        for soup in soups
        if soup.triangle_count
        for bound in (np.min, np.max)
    ]
    if not boxes:
        return np.zeros(3), 1.0
    low, high = np.min(boxes, axis=0), np.max(boxes, axis=0)
    extent = float(np.linalg.norm(high - low))
    return 0.5 * (low + high), _SIZE / extent if extent > 0.0 else 1.0


def _placed(view: dict[str, Any], center: NDArray[np.float64], scale: float) -> dict[str, Any]:
    """Return the same view of triangles that were moved and scaled."""
    pixel = view["pixel"]
    return {
        **view,
        "eye": ((np.array(view["eye"]) - center) * scale).tolist(),
        # at depth 1 under perspective: an angle, which stays
        "pixel": pixel if view["perspective"] else [extent * scale for extent in pixel],
        "near": view["near"] * scale,
        "far": view["far"] * scale,
    }


def _mask(alpha: NDArray[np.uint8] | None, facts: dict[str, Any]) -> NDArray[np.uint8] | None:
    """Return what mitsuba reads as opacity, in 1/255; None where a material is opaque."""
    if facts["alpha_mode"] == "opaque":
        return None
    factor = np.float32(facts["opacity"])
    if alpha is None:
        opacity = np.full((1, 1), factor, np.float32)
    else:
        finer = max(min(_MASK_FACTOR, _MASK_SIDE // max(alpha.shape)), 1)
        opacity = bilinear_alpha(alpha, tuple(facts["wrap"]), finer) * factor
    if facts["alpha_mode"] == "mask":
        opacity = (opacity >= facts["alpha_cutoff"]).astype(np.float32)
    if (opacity == 1.0).all():
        return None
    return quantize(opacity)


def run(arrays: dict[str, NDArray[Any]], settings: dict[str, Any]) -> dict[str, NDArray[Any]]:
    """
    Do the work of `draw`, in the child.

    Parameters
    ----------
    arrays : dict
        ``corners_I``, ``uvs_I``, ``material_ids_I`` and, for colour, ``front_I`` and ``back_I`` of
        soup I; ``alpha_M`` of the texture of materials that are not opaque.
    settings : dict
        ``pictures``, ``materials`` and, if stated, ``threads``.

    Returns
    -------
    dict
        ``picture_I`` and ``secs``.
    """
    import drjit
    import mitsuba

    mitsuba.set_variant("scalar_rgb")
    if "threads" in settings:
        drjit.set_thread_count(settings["threads"])
    result: dict[str, NDArray[Any]] = {}
    secs = []
    scenes: dict[Any, Any] = {}
    for index, picture in enumerate(settings["pictures"]):
        key = picture["soup"], picture["quantity"], str(picture["view"])
        if key not in scenes:
            scenes.clear()
            scenes[key] = _scene(mitsuba, arrays, settings["materials"], picture)
        width, height = picture["view"]["size"]
        integrator, sensor = _integrator(mitsuba, picture), _sensor(mitsuba, picture)
        start = time.perf_counter()
        drawn = mitsuba.render(
            scenes[key],
            sensor=sensor,
            integrator=integrator,
            spp=picture["spp"],
            seed=picture["seed"],
        )
        secs.append(time.perf_counter() - start)
        first, after = picture.get("rows", (0, height))
        values = np.array(drawn, np.float32).reshape(after - first, width, -1)
        result[f"picture_{index}"] = (
            values[..., 3] if picture["quantity"] == "alpha" else values[..., :3]
        )
    return {**result, "secs": np.array(secs)}


def _scene(
    mitsuba: Any,
    arrays: dict[str, NDArray[Any]],
    materials: list[dict[str, Any]],
    picture: Picture,
) -> Any:
    soup, view = picture["soup"], picture["view"]
    corners = arrays[f"corners_{soup}"]
    material_ids = arrays[f"material_ids_{soup}"]
    colors = None
    if picture["quantity"] != "alpha":
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        toward = np.array(view["back"])
        if view["perspective"]:
            toward = np.array(view["eye"]) - corners[:, 0]
        front = (normals * toward).sum(axis=1) > 0.0
        sides = arrays[f"front_{soup}"], arrays[f"back_{soup}"]
        colors = np.where(front[:, np.newaxis, np.newaxis], *sides)
    scene: dict[str, Any] = {"type": "scene"}
    if picture["quantity"] == "sunlit":
        # radiance of a white surface that faces the sun: irradiance over pi
        irradiance = {"type": "rgb", "value": [np.pi] * 3}
        travels = [-x for x in picture["sun"]]
        scene["sun"] = {"type": "directional", "direction": travels, "irradiance": irradiance}
    masks = {int(i): _mask(arrays.get(f"alpha_{i}"), materials[i]) for i in np.unique(material_ids)}
    clear = np.isin(material_ids, [i for i, mask in masks.items() if mask is not None])
    groups: list[tuple[Any, Any, NDArray[np.bool_]]] = [(None, "repeat", ~clear)]
    for index, mask in masks.items():
        if mask is not None:
            groups.append((mask, materials[index]["wrap"], material_ids == index))
    for index, (mask, wrap, chosen) in enumerate(groups):
        if not chosen.any():
            continue
        uvs = arrays[f"uvs_{soup}"][chosen]
        pieces = [(mask, corners[chosen], uvs)]
        side_parts = picture.get("side_parts", 1)
        if colors is None and mask is not None and mask.size > 1 and side_parts > 1:
            parts = parted(corners[chosen], uvs, mask, wrap[0], side_parts)
            pieces = [
                (None, parts.corners[parts.opaque], parts.uvs[parts.opaque]),
                (mask, parts.corners[~parts.opaque], parts.uvs[~parts.opaque]),
            ]
        own = None if colors is None else colors[chosen]
        for number, (opacity, places, own_uvs) in enumerate(pieces):
            if len(places):
                bsdf = _bsdf(opacity, wrap, colored=colors is not None)
                mesh = _mesh(mitsuba, places, own_uvs, own, bsdf)
                scene[f"mesh_{index}_{number}"] = mesh
    return mitsuba.load_dict(scene)


def _bsdf(mask: NDArray[np.uint8] | None, wrap: Any, *, colored: bool) -> dict[str, Any]:
    import mitsuba

    # black where only coverage counts: a path ends at the first surface that it does not pass
    reflectance: Any = {"type": "rgb", "value": 0.0}
    if colored:
        reflectance = {"type": "mesh_attribute", "name": "vertex_color"}
    diffuse = {"type": "diffuse", "reflectance": reflectance}
    surface: dict[str, Any] = {"type": "twosided", "bsdf": diffuse}
    if mask is None:
        return surface
    opacity = {
        "type": "bitmap",
        "bitmap": mitsuba.Bitmap(mask[..., np.newaxis]),
        "raw": True,
        "filter_type": "nearest",
        # of both axes: others are refused before
        "wrap_mode": wrap[0],
    }
    return {"type": "mask", "opacity": opacity, "bsdf": surface}


def _mesh(
    mitsuba: Any,
    corners: NDArray[np.float32],
    uvs: NDArray[np.float32],
    colors: NDArray[np.float32] | None,
    bsdf: dict[str, Any],
) -> Any:
    properties = mitsuba.Properties()
    properties["bsdf"] = mitsuba.load_dict(bsdf)
    count = len(corners)
    mesh = mitsuba.Mesh(
        "soup",
        vertex_count=3 * count,
        face_count=count,
        has_vertex_normals=False,
        has_vertex_texcoords=True,
        props=properties,
    )
    if colors is not None:
        mesh.add_attribute("vertex_color", 3, np.ascontiguousarray(colors, np.float32).ravel())
    values = mitsuba.traverse(mesh)
    values["vertex_positions"] = np.ascontiguousarray(corners, np.float32).ravel()
    values["vertex_texcoords"] = np.ascontiguousarray(uvs, np.float32).ravel()
    values["faces"] = np.arange(3 * count, dtype=np.uint32)
    values.update()
    return mesh


def _integrator(mitsuba: Any, picture: Picture) -> Any:
    if picture["quantity"] == "color":
        return mitsuba.load_dict({"type": "aov", "aovs": "color:albedo"})
    if picture["quantity"] == "sunlit":
        return mitsuba.load_dict({"type": "direct", "hide_emitters": True})
    # passing a mask counts as a bounce, so neither depth nor roulette may end a path
    path = {"type": "path", "hide_emitters": True, "max_depth": -1, "rr_depth": 1_000_000}
    return mitsuba.load_dict(path)


def _sensor(mitsuba: Any, picture: Picture) -> Any:
    view = picture["view"]
    width, height = view["size"]
    eye, up, back = (np.array(view[name]) for name in ("eye", "up", "back"))
    transform = mitsuba.ScalarTransform4f()
    # far ahead: mitsuba takes the difference of the two in f32, and a target one unit away would
    # turn the view by as much as the eye is rounded
    ahead = eye - view["far"] * back
    to_world = transform.look_at(eye.tolist(), ahead.tolist(), up.tolist())
    film = {
        "type": "hdrfilm",
        "width": width,
        "height": height,
        "pixel_format": "rgba",
        "component_format": "float32",
        "rfilter": {"type": "box"},
    }
    if "rows" in picture:
        first, after = picture["rows"]
        film |= {
            "crop_offset_x": 0,
            "crop_offset_y": first,
            "crop_width": width,
            "crop_height": after - first,
        }
    sensor: dict[str, Any] = {
        "near_clip": view["near"],
        "far_clip": view["far"],
        "film": film,
        "sampler": {"type": picture["sampler"], "sample_count": picture["spp"]},
    }
    across, along = view["pixel"]
    if view["perspective"]:
        sensor["type"] = "perspective"
        sensor["fov_axis"] = "y"
        sensor["fov"] = float(np.degrees(2.0 * np.arctan(along * height / 2.0)))
    else:
        # the sensor sees 2 units across, and as many pixels of the same size along
        sensor["type"] = "orthographic"
        scale = [across * width / 2.0, along * width / 2.0, 1.0]
        to_world = to_world @ transform.scale(scale)
    return mitsuba.load_dict({**sensor, "to_world": to_world})
