"""Rays through Blender's own Embree: three times as fast as the tree in `bvh`, and there wherever Cycles is.

Blender loads Embree for Cycles. If this process holds it, and it answers a ray as it should, `build_scene` hands triangles
to it and kernels call `occluded` and `intersect`; nothing is loaded that Blender has not loaded. Elsewhere (a plain Python,
a Blender without a shared Embree, kernels run without compiler) `bvh` grows a tree of its own.

Kernels get the addresses as numbers: numba cannot keep a kernel with a ctypes function in its cache.
The structs are those of Embree 4 (embree4/rtcore_ray.h), aligned to 16 bytes: a ray of 12 words, a hit of at most 9.
"""

from __future__ import annotations

import ctypes
import functools
import os
import sys
import weakref
from typing import Any

import numba
import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

from .jit import device_jit

_NAMES = {"linux": ("libembree4.so.4", "libembree4.so"), "win32": ("embree4.dll",)}
_VERSIONS = range(40000, 50000)     # rtcGetDeviceProperty's number for 4.0.0 up to 5
_TRIANGLES, _INDEX, _VERTEX, _FLOAT3, _UINT3, _ROBUST = 0, 0, 1, 0x9003, 0x5003, 4
_PADDING = 16                       # bytes that Embree may read behind the last vertex
_RAY_WORDS, _WORDS, _ALIGNMENT = 12, 24, 16
_T_FAR, _MASK, _U, _V, _PRIMITIVE = 8, 9, 15, 16, 17


def _image_on_mac() -> str | None:
    """Path of the Embree library that this process has loaded."""
    dyld = ctypes.CDLL(None)
    dyld._dyld_get_image_name.restype = ctypes.c_char_p
    names = (dyld._dyld_get_image_name(i) or b"" for i in range(dyld._dyld_image_count()))
    return next((name.decode() for name in names if b"libembree4" in name), None)


def _loaded_library() -> Any:
    """Blender's Embree as a ctypes library, or None where this process has none."""
    if sys.platform == "win32":
        ctypes.windll.kernel32.GetModuleHandleW.restype = ctypes.c_void_p
        for name in _NAMES["win32"]:
            handle = ctypes.windll.kernel32.GetModuleHandleW(name)
            if handle:
                return ctypes.CDLL(name, handle=handle)
        return None
    names = (_image_on_mac(),) if sys.platform == "darwin" else _NAMES["linux"]
    for name in filter(None, names):
        try:
            return ctypes.CDLL(name, mode=os.RTLD_NOLOAD | os.RTLD_LOCAL)
        except OSError:
            continue
    return None


class _Embree:
    """The library with its device; scenes are made by `build`."""

    def __init__(self, library: Any):
        pointer, number, size = ctypes.c_void_p, ctypes.c_uint, ctypes.c_size_t
        signatures = {
            "rtcNewDevice": (pointer, [ctypes.c_char_p]),
            "rtcGetDeviceProperty": (ctypes.c_ssize_t, [pointer, ctypes.c_int]),
            "rtcGetDeviceError": (ctypes.c_int, [pointer]),
            "rtcNewScene": (pointer, [pointer]),
            "rtcSetSceneFlags": (None, [pointer, ctypes.c_int]),
            "rtcNewGeometry": (pointer, [pointer, ctypes.c_int]),
            "rtcSetNewGeometryBuffer": (pointer, [pointer, ctypes.c_int, number, ctypes.c_int, size, size]),
            "rtcCommitGeometry": (None, [pointer]),
            "rtcAttachGeometry": (number, [pointer, pointer]),
            "rtcReleaseGeometry": (None, [pointer]),
            "rtcCommitScene": (None, [pointer]),
            "rtcReleaseScene": (None, [pointer]),
        }
        for name, (result, arguments) in signatures.items():
            function = getattr(library, name)
            function.restype, function.argtypes = result, arguments
        self.library = library
        self.device = library.rtcNewDevice(None)
        self.version = library.rtcGetDeviceProperty(self.device, 0) if self.device else 0
        self.functions = [ctypes.cast(getattr(library, name), pointer).value for name in ("rtcOccluded1", "rtcIntersect1")]

    def build(self, triangles: np.ndarray) -> int | None:
        """Address of a scene over (T, 3, 3) float32 triangles, or None if Embree failed."""
        lib, count = self.library, len(triangles)
        scene = lib.rtcNewScene(self.device)
        lib.rtcSetSceneFlags(scene, _ROBUST)
        if count:
            mesh = lib.rtcNewGeometry(self.device, _TRIANGLES)
            vertices = lib.rtcSetNewGeometryBuffer(mesh, _VERTEX, 0, _FLOAT3, 12, 3 * count + _PADDING // 12 + 1)
            index = lib.rtcSetNewGeometryBuffer(mesh, _INDEX, 0, _UINT3, 12, count)
            if vertices and index:
                order = np.arange(3 * count, dtype=np.uint32)
                ctypes.memmove(vertices, triangles.ctypes.data, triangles.nbytes)
                ctypes.memmove(index, order.ctypes.data, order.nbytes)
                lib.rtcCommitGeometry(mesh)
                lib.rtcAttachGeometry(scene, mesh)
            lib.rtcReleaseGeometry(mesh)
        lib.rtcCommitScene(scene)
        if lib.rtcGetDeviceError(self.device):
            lib.rtcReleaseScene(scene)
            return None
        return scene


@functools.cache
def _shared() -> _Embree | None:
    """Embree, if it is loaded, of a known version, and right about a triangle; asked once Blender is there."""
    library = _loaded_library()
    if library is None:
        return None
    try:
        embree = _Embree(library)
    except AttributeError:                       # another library under that name
        return None
    if embree.version not in _VERSIONS:
        return None
    scene = embree.build(np.array([[[-1, -1, 2], [3, -1, 2], [-1, 3, 2]]], np.float32))
    if scene is None:
        return None
    try:
        (t, slot, u, v), is_blocked, is_free = _ask(np.array([scene, *embree.functions], np.uint64))
    finally:
        embree.library.rtcReleaseScene(scene)
    right = slot == 0 and is_blocked and is_free and np.allclose([t, u, v], [2, 0.25, 0.25], atol=1e-5)
    return embree if right else None


def embree_version() -> str:
    """Version of the Embree that rays go through, or "" where they go through RTGI's own tree."""
    embree = _shared() if "bpy" in sys.modules and not numba.config.DISABLE_JIT else None
    if embree is None:
        return ""
    return f"{embree.version // 10000}.{embree.version // 100 % 100}.{embree.version % 100}"


def build_scene(triangles: np.ndarray) -> np.ndarray:
    """(3,) uint64: addresses of a scene over (T, 3, 3) float32 triangles and of its two functions; zeros without Embree.

    The scene is freed with this array.
    """
    embree = _shared() if embree_version() else None
    scene = embree.build(np.ascontiguousarray(triangles, np.float32)) if embree else None
    if scene is None:
        return np.zeros(3, np.uint64)
    rays = np.array([scene, *embree.functions], np.uint64)
    weakref.finalize(rays, embree.library.rtcReleaseScene, scene).atexit = False
    return rays


def _words(builder: ir.IRBuilder, numbers: list[tuple[int, Any]]) -> tuple[ir.Value, ir.Value]:
    """A ray-and-hit on the kernel's stack with these words set: (pointer to its words, pointer for the call)."""
    word, byte = ir.FloatType(), ir.IntType(8).as_pointer()
    memory = cgutils.alloca_once(builder, ir.ArrayType(word, _WORDS))
    memory.align = _ALIGNMENT
    words = builder.bitcast(memory, word.as_pointer())
    for at, value in numbers:
        place = builder.gep(words, [ir.Constant(ir.IntType(32), at)])
        if value.type != word:
            place = builder.bitcast(place, value.type.as_pointer())
        builder.store(value, place)
    return words, builder.bitcast(memory, byte)


def _call(builder: ir.IRBuilder, rays: Any, function: int, memory: ir.Value) -> None:
    """rays[function](scene, memory, no arguments)."""
    byte, index = ir.IntType(8).as_pointer(), ir.IntType(32)

    def address(at: int) -> ir.Value:
        return builder.load(builder.gep(rays.data, [ir.Constant(index, at)]))

    kind = ir.FunctionType(ir.VoidType(), [byte, byte, byte])
    builder.call(builder.inttoptr(address(function), kind.as_pointer()),
                 [builder.inttoptr(address(0), byte), memory, ir.Constant(byte, None)])


def _ray(values: list[ir.Value], near: ir.Value, far: ir.Value) -> list[tuple[int, Any]]:
    all_bits, none = ir.Constant(ir.IntType(32), 0xFFFFFFFF), ir.Constant(ir.IntType(32), 0)
    zero = ir.Constant(ir.FloatType(), 0.0)
    ox, oy, oz, dx, dy, dz = values
    return [(0, ox), (1, oy), (2, oz), (3, near), (4, dx), (5, dy), (6, dz), (7, zero), (_T_FAR, far), (_MASK, all_bits),
            (10, none), (11, none)]


_ADDRESSES = types.Array(types.uint64, 1, "C")
_FLOATS = (types.float32,) * 6


@intrinsic
def _far_after_occlusion(typing, rays, ox, oy, oz, dx, dy, dz, far):
    """`far`, or a negative number if a triangle meets the ray from (ox, oy, oz) to `far` times (dx, dy, dz)."""
    signature = types.float32(_ADDRESSES, *_FLOATS, types.float32)

    def generate(context, builder, signature, arguments):
        rays = context.make_array(_ADDRESSES)(context, builder, arguments[0])
        words, memory = _words(builder, _ray(arguments[1:7], ir.Constant(ir.FloatType(), 0.0), arguments[7]))
        _call(builder, rays, 1, memory)
        return builder.load(builder.gep(words, [ir.Constant(ir.IntType(32), _T_FAR)]))

    return signature, generate


@intrinsic
def intersect(typing, rays, ox, oy, oz, dx, dy, dz, near, far):
    """(t, triangle, u, v) of the nearest hit between `near` and `far`; triangle -1 for none; weights u, v as in `bvh`."""
    result = types.Tuple((types.float32, types.int32, types.float32, types.float32))
    signature = result(_ADDRESSES, *_FLOATS, types.float32, types.float32)

    def generate(context, builder, signature, arguments):
        rays = context.make_array(_ADDRESSES)(context, builder, arguments[0])
        nothing = ir.Constant(ir.IntType(32), 0xFFFFFFFF)
        hit = [(_PRIMITIVE, nothing), *((at, nothing) for at in range(_PRIMITIVE + 1, 21))]
        words, memory = _words(builder, [*_ray(arguments[1:7], *arguments[7:]), *hit])
        _call(builder, rays, 2, memory)

        def word(at: int) -> ir.Value:
            return builder.gep(words, [ir.Constant(ir.IntType(32), at)])

        slot = builder.load(builder.bitcast(word(_PRIMITIVE), ir.IntType(32).as_pointer()))
        return context.make_tuple(builder, result, [builder.load(word(_T_FAR)), slot, builder.load(word(_U)),
                                                    builder.load(word(_V))])

    return signature, generate


@device_jit
def occluded(rays, ox, oy, oz, dx, dy, dz, far):
    """Does a triangle of the scene meet the ray before `far` times its direction?"""
    return _far_after_occlusion(rays, ox, oy, oz, dx, dy, dz, far) < np.float32(0)


@device_jit
def _ask(rays):
    through = intersect(rays, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 1e9)
    return (through, occluded(rays, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 3.0),
            not occluded(rays, 0.0, 0.0, 0.0, 0.0, 0.0, -1.0, 3.0))
