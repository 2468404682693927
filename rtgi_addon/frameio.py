"""Frames to .npz files and back, so that every pass runs, is tested and is profiled without Blender."""

from __future__ import annotations

import dataclasses
import json
import os
import zipfile
from typing import Any

import numpy as np

from .core.frame import Cutouts, Frame, GBuffer, Geometry, Light, LightKind, LightView, Material, World
from .core.transforms import Camera, Projection
from .errors import InputError

FORMAT = 1                  # raised when an old file can no longer be read


def _camera_to_json(camera: Camera) -> dict[str, Any]:
    return {**{f.name: getattr(camera, f.name) for f in dataclasses.fields(camera)},
            "projection": camera.projection.value, "world_from_view": camera.world_from_view.tolist()}


def _camera_from_json(values: dict[str, Any]) -> Camera:
    return Camera(**{**values, "projection": Projection(values["projection"]),
                     "world_from_view": np.array(values["world_from_view"])})


def _light_to_json(light: Light) -> dict[str, Any]:
    return {**{f.name: getattr(light, f.name) for f in dataclasses.fields(light)}, "kind": light.kind.value,
            "world_from_light": light.world_from_light.tolist(), "power": np.asarray(light.power).tolist()}


def _light_from_json(values: dict[str, Any]) -> Light:
    return Light(**{**values, "kind": LightKind(values["kind"]), "world_from_light": np.array(values["world_from_light"]),
                    "power": np.array(values["power"])})


def _put(arrays: dict[str, np.ndarray], prefix: str, value: Any) -> None:
    """The arrays of a dataclass, those of dataclasses in it too; what is None is left out."""
    for f in dataclasses.fields(value):
        part = getattr(value, f.name)
        if dataclasses.is_dataclass(part):
            _put(arrays, f"{prefix}.{f.name}", part)
        elif part is not None:
            arrays[f"{prefix}.{f.name}"] = part


def _take(file: Any, prefix: str, kind: type, **parts: Any) -> Any:
    """What `_put` put; `parts` are fields that hold no array."""
    names = (f.name for f in dataclasses.fields(kind) if f.name not in parts)
    return kind(**{name: file[f"{prefix}.{name}"] for name in names}, **parts)


def _take_gbuffer(file: Any, prefix: str) -> GBuffer:
    # files from before materials told it hold none
    return _take(file, prefix, GBuffer, f0=file.get(f"{prefix}.f0"))


def _take_geometry(file: Any) -> Geometry:
    # files from before there were cutouts, or shading normals, hold none
    has_cutouts = "geometry.cutouts.row" in file
    return _take(file, "geometry", Geometry, cutouts=_take_cutouts(file) if has_cutouts else None,
                 normals_ws=file.get("geometry.normals_ws"))


def _take_cutouts(file: Any) -> Cutouts:
    return _take(file, "geometry.cutouts", Cutouts, most_layers=int(file["geometry.cutouts.most_layers"]))


def save_frame(path: str | os.PathLike, frame: Frame) -> None:
    """Write `frame` to an .npz file; nothing of it is lost."""
    arrays: dict[str, np.ndarray] = {"origin_ws": frame.origin_ws, "world": frame.world.radiance}
    _put(arrays, "gbuffer", frame.gbuffer)
    for i, view in enumerate(frame.views):
        _put(arrays, f"view{i}", view.gbuffer)
        arrays[f"view{i}.incident_flux"] = view.incident_flux
    if frame.geometry is not None:
        _put(arrays, "geometry", frame.geometry)
    head = {"format": FORMAT, "camera": _camera_to_json(frame.camera), "lights": [_light_to_json(v) for v in frame.lights],
            "views": [{"light_index": v.light_index, "camera": _camera_to_json(v.camera)} for v in frame.views],
            "materials": [dataclasses.asdict(m) for m in frame.materials], "warnings": list(frame.warnings),
            "has_geometry": frame.geometry is not None}
    np.savez(path, head=np.array(json.dumps(head)), **arrays)


def load_frame(path: str | os.PathLike) -> Frame:
    """Read a frame that `save_frame` wrote; InputError for anything else."""
    try:
        file = np.load(path, allow_pickle=False)
        head = json.loads(str(file["head"]))
    except FileNotFoundError:
        raise InputError(f"there is no file {os.fspath(path)}") from None
    except (OSError, EOFError, ValueError, KeyError, zipfile.BadZipFile):
        raise InputError(f"{os.fspath(path)} is not a frame saved by RTGI") from None
    if head["format"] != FORMAT:
        raise InputError(f"{os.fspath(path)} has frame format {head['format']}, this RTGI reads {FORMAT}; capture it again")
    with file:
        views = tuple(LightView(v["light_index"], _camera_from_json(v["camera"]), _take_gbuffer(file, f"view{i}"),
                                file[f"view{i}.incident_flux"]) for i, v in enumerate(head["views"]))
        materials = tuple(Material(**{k: tuple(v) if isinstance(v, list) else v for k, v in m.items()})
                          for m in head["materials"])
        return Frame(
            camera=_camera_from_json(head["camera"]), gbuffer=_take_gbuffer(file, "gbuffer"),
            lights=tuple(_light_from_json(v) for v in head["lights"]), views=views,
            geometry=_take_geometry(file) if head["has_geometry"] else None, materials=materials,
            world=World(file["world"]), origin_ws=file["origin_ws"], warnings=tuple(head["warnings"]))
