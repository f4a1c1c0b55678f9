"""What this machine can draw with: devices, drivers, the context that wins and why, and what is missing."""

import importlib.metadata
import importlib.util
import os
import platform
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from avatar.camera import orbit_camera
from player.context import Context, Egl, NoContextError, _library, open_context

# what lacks when a library does not load, by its Debian and Ubuntu package
LIBRARIES = {
    "libEGL.so.1": ("libegl1", "contexts without a display"),
    "libGL.so.1": ("libgl1", "windows"),
    "libOSMesa.so.8": (
        "libosmesa6",
        "drawing in memory alone (gone from Mesa 25.1 on; optional where EGL works)",
    ),
}
DRIVERS = ("libgl1-mesa-dri", "Mesa's drivers, llvmpipe among them")
VENDORS = ("/usr/share/glvnd/egl_vendor.d", "/etc/glvnd/egl_vendor.d")
EXTRAS = {
    "films": ("av",),
    "window": ("glfw",),
    "train": ("torch", "scipy", "skimage", "trimesh"),
    "bake": ("xatlas", "fast_simplification", "onnx", "onnxruntime"),
    "bench": ("matplotlib", "flip_evaluator"),
    "gui": ("imgui_bundle",),
    "live": ("websockets",),
    "inspect": ("pyvista",),
}


def findings() -> dict[str, Any]:
    """Everything `selfscan doctor` says, as data."""
    found: dict[str, Any] = {
        "machine": f"{platform.system()} {platform.release()}, Python {platform.python_version()}, "
        f"{len(os.sched_getaffinity(0)) if hasattr(os, 'sched_getaffinity') else os.cpu_count()} CPU cores"
    }
    found["missing"] = missing = []
    for library, (package, purpose) in LIBRARIES.items():
        try:
            _library(library, library.split(".so")[0] + ".so")
        except OSError:
            missing.append({"package": package, "for": purpose})
    found["egl_vendors"] = sorted(file.name for folder in VENDORS for file in Path(folder).glob("*.json"))
    try:
        egl = Egl()
        found["egl_devices"] = [str(device) for device in egl.devices()]
    except OSError as error:
        found["egl_devices"] = []
        found["egl_error"] = str(error)
    found["tried"] = []
    found["winner"] = None
    for kind in ("egl", "osmesa"):
        try:
            context = open_context(kind)
        except NoContextError as error:
            found["tried"].append({"kind": kind, "works": False, "why": str(error)})
            continue
        version = context.gl.info["GL_VERSION"]
        found["tried"].append({"kind": kind, "works": True, "attempts": context.attempts})
        if found["winner"] is None:
            why = "first in the order EGL device, EGL surfaceless, OSMesa that works"
            winner = {
                "kind": kind,
                "name": context.driver.name,
                "renderer": context.renderer,
                "version": version,
            }
            found["winner"] = winner | {"software": context.software, "why": why}
        context.release()
    if found["winner"] is None and not any(m["package"] in ("libegl1", "libgl1") for m in missing):
        missing.append({"package": DRIVERS[0], "for": DRIVERS[1]})
    found["packages"] = {extra: {name: _version(name) for name in names} for extra, names in EXTRAS.items()}
    found["display"] = os.environ.get("WAYLAND_DISPLAY") or os.environ.get("DISPLAY")
    return found


def report(found: dict[str, Any]) -> str:
    """The findings in a few lines."""
    lines = [found["machine"]]
    lines.append(f"EGL vendor files: {', '.join(found['egl_vendors']) or 'none'}")
    lines.append(f"EGL devices: {'; '.join(found['egl_devices']) or found.get('egl_error', 'none')}")
    for tried in found["tried"]:
        if tried["works"]:
            lines += [f"  {tried['kind']:7} works   {line}" for line in tried["attempts"]]
        else:
            lines.append(f"  {tried['kind']:7} fails   {tried['why']}")
    winner = found["winner"]
    if winner is None:
        lines.append("no context works: nothing can be drawn on this machine yet")
    else:
        lines.append(
            f"draws with {winner['name']}: {winner['renderer']}, OpenGL {winner['version']} ({winner['why']})"
        )
        if winner["software"]:
            lines.append(
                "  this is the processor, not a GPU: right for CI, slower than a driver for your card"
            )
    lines.append(f"display: {found['display'] or 'none (selfscan render needs none; selfscan play does)'}")
    for extra, packages in found["packages"].items():
        there = [f"{name} {version}" for name, version in packages.items() if version]
        absent = [name for name, version in packages.items() if not version]
        lines.append(f"  {extra:8} {', '.join(there)}{'  absent: ' + ', '.join(absent) if absent else ''}")
    if found["missing"]:
        lines += [f"missing: {item['package']} ({item['for']})" for item in found["missing"]]
        lines.append(f"  sudo apt-get install {' '.join(item['package'] for item in found['missing'])}")
    else:
        lines.append("no system package is missing")
    return "\n".join(lines)


def compare(size: int = 512) -> dict[str, Any]:
    """One frame of the built-in body on EGL and on OSMesa: equal within 1/255 outside the silhouette's pixels?"""
    from player.mannequin import mannequin
    from player.renderer import Renderer

    avatar, pose = mannequin(), (np.zeros((52, 3)), np.zeros(3))
    camera = orbit_camera((0, 0, 0), 2.6, 0.5, 0.1, (size, size))
    images = {}
    for kind in ("egl", "osmesa"):
        try:
            context: Context = open_context(kind)
        except NoContextError as error:
            return {"equal": False, "text": f"compare: {kind} does not work: {error}"}
        renderer = Renderer(context, [avatar], (size, size), view="off")
        images[kind] = renderer.draw([pose], camera)
        context.release()
    worst, share = difference(images["egl"], images["osmesa"])
    equal = worst <= 1
    text = (
        f"compare: EGL and OSMesa differ by at most {worst}/255 outside a one-pixel silhouette band "
        f"({100 * share:.2f} % of pixels lie in it): {'equal' if equal else 'NOT equal'}"
    )
    return {"equal": equal, "worst": worst, "band": share, "text": text}


def difference(a: np.ndarray, b: np.ndarray) -> tuple[int, float]:
    """Largest channel difference of two images outside a one-pixel band round their silhouettes, and its share."""
    band = np.zeros(a.shape[:2], bool)
    for image in (a, b):
        inside = image[..., 3] > 0
        wide = np.pad(inside, 1, "edge")
        shifts = [wide[y : y + len(inside), x : x + inside.shape[1]] for y in range(3) for x in range(3)]
        band |= np.logical_or.reduce(shifts) & ~np.logical_and.reduce(shifts)
    gap = np.abs(a.astype(int) - b.astype(int)).max(-1)
    return int(gap[~band].max(initial=0)), float(band.mean())


@cache
def _distributions() -> Mapping[str, list[str]]:
    return importlib.metadata.packages_distributions()


def _version(module: str) -> str | None:
    if importlib.util.find_spec(module) is None:
        return None
    names = _distributions().get(module, [module])
    try:
        return importlib.metadata.version(names[0])
    except importlib.metadata.PackageNotFoundError:
        return "present"
