"""`selfscan doctor`: what this machine can draw with. Devices, drivers, the context that wins and why, what is missing,
and whether every way to OpenGL shows the same frame."""

import importlib.metadata
import json
import os
import platform
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import numpy as np
from jaxtyping import UInt8

from avatar.baked_avatar import Avatar
from avatar.camera import Camera, orbit_camera
from command.command_line import Help, Option, parse
from command.errors import AssetError
from files.whole import write_json
from player.gl.context import Egl, EglDevice, NoContextError, _library, open_context

# what lacks when a library does not load: its package on Debian and Ubuntu, and what it is for
LIBRARIES = {
    "libEGL.so.1": ("libegl1", "contexts without a display"),
    "libGL.so.1": ("libgl1", "windows"),
    "libOSMesa.so.8": ("libosmesa6", "drawing in memory alone (gone from Mesa 25.1 on; optional where EGL works)"),
}
DRIVERS = ("libgl1-mesa-dri", "Mesa's drivers, llvmpipe among them")
VENDORS = ("/usr/share/glvnd/egl_vendor.d", "/etc/glvnd/egl_vendor.d")
VENDOR_VARIABLES = ("__EGL_VENDOR_LIBRARY_FILENAMES", "__EGL_VENDOR_LIBRARY_DIRS")
EXTRAS = {
    "films": ("av",), "window": ("glfw",), "gui": ("imgui-bundle",), "live": ("websockets",),
    "cluster": ("distributed",), "train": ("torch", "scipy", "scikit-image", "trimesh", "rtree"),
    "bake": ("xatlas", "fast-simplification", "onnx"), "bench": ("matplotlib", "flip-evaluator"),
    "inspect": ("pyvista",),
}  # fmt: skip
Findings = dict[str, Any]


@dataclass(frozen=True)
class DoctorCommand:
    compare: Annotated[str | None, Option(metavar="AVATAR", const="mannequin"),
        "draw one frame (of the built-in body) on EGL, on OSMesa and in a window, and compare them"] = None
    json: Annotated[Path | None, Option(metavar="FILE"), "write the findings to a file"] = None


DOCTOR = Help("selfscan doctor", "Which OpenGL contexts work here, which one wins and why, and what is missing.")


def doctor_main(argv: list[str]) -> int:
    """Print what this machine can draw with."""
    options = parse(DoctorCommand, argv, DOCTOR)
    found = findings()
    print(report(found))
    worked = found["winner"] is not None
    if options.compare:
        result = compare(options.compare)
        found["compare"] = result
        print(result["text"])
        worked = worked and result["equal"]
    if options.json:
        write_json(options.json, found)
    return 0 if worked else 1


class Node(NamedTuple):
    """A device file of a graphics card, and whether it may be opened for reading and writing."""

    path: str
    usable: bool


def findings() -> Findings:
    """Everything `selfscan doctor` says, as data."""
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    system = f"{platform.system()} {platform.release()}, Python {platform.python_version()}"
    missing = []
    found: Findings = {"machine": f"{system}, {cores} CPU cores", "missing": missing}
    for library, (package, purpose) in LIBRARIES.items():
        try:
            _library(library, library.split(".so")[0] + ".so")
        except OSError:
            missing.append({"package": package, "library": library, "for": purpose})
    found["egl_vendors"] = [vendor_file(path) for path in vendor_files()]
    nodes = device_nodes()
    found["nodes"] = [node._asdict() for node in nodes]
    found["nvidia"] = nvidia_driver()
    devices: list[EglDevice] = []
    try:
        devices = Egl().devices()
    except OSError as error:
        found["egl_error"] = str(error)
    found |= {"egl_devices": [str(device) for device in devices], "tried": [], "winner": None}
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
            winner = {"kind": kind, "name": context.driver.name, "renderer": context.renderer, "version": version}
            found["winner"] = winner | {"software": context.software, "why": why}
        context.release()
    if found["winner"] is None and not any(m["library"] in ("libEGL.so.1", "libGL.so.1") for m in missing):
        missing.append({"package": DRIVERS[0], "library": "Mesa", "for": DRIVERS[1]})
    install = f"sudo apt-get install {' '.join(m['package'] for m in missing)}"
    found["install"] = install if missing else None
    found["packages"] = {extra: {name: _version(name) for name in names} for extra, names in EXTRAS.items()}
    found["display"] = os.environ.get("WAYLAND_DISPLAY") or os.environ.get("DISPLAY")
    found["container"] = Path("/.dockerenv").exists() or Path("/run/.containerenv").exists()
    software = found["winner"] is None or found["winner"]["software"]
    card = {"devices": devices, "nodes": nodes, "nvidia": found["nvidia"], "vendors": found["egl_vendors"]}
    found["hints"] = hints(**card, software=software, container=found["container"])
    return found


def vendor_files() -> list[Path]:
    """The files that name libEGL's drivers, as libglvnd finds them."""
    named = os.environ.get(VENDOR_VARIABLES[0])
    if named:
        return [Path(name) for name in named.split(":") if name]
    folders = (os.environ.get(VENDOR_VARIABLES[1]) or ":".join(reversed(VENDORS))).split(":")
    return [file for folder in folders for file in sorted(Path(folder).glob("*.json"))]


def vendor_file(path: Path) -> Findings:
    out: Findings = {"file": str(path), "library": None, "wrong": None}
    try:
        out["library"] = json.loads(path.read_text("utf-8"))["ICD"]["library_path"]
        _library(out["library"])
    except (OSError, ValueError, KeyError, TypeError) as error:
        out["wrong"] = str(error) or type(error).__name__
    return out


def device_nodes(folder: Path = Path("/dev")) -> list[Node]:
    """Device files of graphics cards, and whether this user may open them."""
    files = [*sorted((folder / "dri").glob("renderD*")), *sorted(folder.glob("nvidia[0-9]*"))]
    return [Node(str(file), os.access(file, os.R_OK | os.W_OK)) for file in files]


def nvidia_driver(file: Path = Path("/proc/driver/nvidia/version")) -> str | None:
    """The version line of NVIDIA's kernel driver; None: there is none."""
    try:
        return file.read_text("utf-8").splitlines()[0]
    except (OSError, IndexError):
        return None


def hints(
    *, devices: Sequence[EglDevice], nodes: Sequence[Node], nvidia: str | None, vendors: Sequence[Findings],
    software: bool, container: bool,
) -> list[str]:  # fmt: skip
    """What to do where a card is there and is not drawn with, one line each."""
    out = [f"{vendor['file']}: its driver does not load: {vendor['wrong']}" for vendor in vendors if vendor["wrong"]]
    closed = [node.path for node in nodes if not node.usable]
    if closed:
        groups = "--group-add render" if container else "sudo usermod -aG render,video $USER, then log in again"
        out.append(f"{', '.join(closed)} may not be opened by this user: {groups}")
    has_nvidia = nvidia is not None or any("nvidia" in node.path for node in nodes)
    if has_nvidia and not any(device.cuda is not None for device in devices):
        known = any("nvidia" in str(vendor["library"]) and not vendor["wrong"] for vendor in vendors)
        if container:
            out.append("an NVIDIA card without its OpenGL: start the container with --gpus all -e "
                       "NVIDIA_DRIVER_CAPABILITIES=graphics,compute,utility")  # fmt: skip
        if not known:
            out.append("NVIDIA's EGL is not known to libEGL: install libnvidia-gl of the driver's version, or write "
                       '/usr/share/glvnd/egl_vendor.d/10_nvidia.json: {"file_format_version": "1.0.0", "ICD": '
                       '{"library_path": "libEGL_nvidia.so.0"}}')  # fmt: skip
    elif software and container and not nodes:
        flags = "--device /dev/dri (Intel, AMD) or --gpus all (NVIDIA)"
        out.append(f"no graphics card is visible in this container: {flags}")
    hardware = [device for device in devices if not device.software]
    if software and hardware and not out:
        out.append(f"{hardware[0]} is there and does not draw: see why above; --gpu asks for it alone")
    return out


def report(found: Findings) -> str:
    """The findings in a few lines."""
    lines, vendors = [found["machine"]], found["egl_vendors"]
    lines += [f"EGL vendor file {one['file']}: {one['library'] or one['wrong']}" for one in vendors]
    lines += [] if vendors else ["EGL vendor files: none"]
    nodes = [node["path"] + ("" if node["usable"] else " (no permission)") for node in found["nodes"]]
    lines.append(f"device files: {', '.join(nodes) or 'none'}")
    if found["nvidia"]:
        lines.append(found["nvidia"])
    lines.append(f"EGL devices: {'; '.join(found['egl_devices']) or found.get('egl_error', 'none')}")
    for tried in found["tried"]:
        word, said = ("works", tried["attempts"]) if tried["works"] else ("fails", [tried["why"]])
        lines += [f"  {tried['kind']:7} {word}   {line}" for line in said]
    winner = found["winner"]
    if winner is None:
        lines.append("no context works: nothing can be drawn on this machine yet")
    else:
        lines.append(f"draws with {winner['name']}: {winner['renderer']}, OpenGL {winner['version']} ({winner['why']})")
        if winner["software"]:
            lines.append("  this is the processor, not a GPU: right for CI, slower than a driver for your card")
    lines.append(f"display: {found['display'] or 'none (selfscan render needs none; selfscan play does)'}")
    for extra, packages in found["packages"].items():
        there = [f"{name} {version}" for name, version in packages.items() if version]
        absent = [name for name, version in packages.items() if not version]
        lines.append(f"  {extra:8} {', '.join(there)}{'  absent: ' + ', '.join(absent) if absent else ''}")
    if found["missing"]:
        lines += [f"missing: {item['package']} ({item['for']})" for item in found["missing"]]
        lines.append(f"  {found['install']}")
    else:
        lines.append("no system package is missing")
    lines += [f"hint: {hint}" for hint in found["hints"]]
    return "\n".join(lines)


# a picture in each view mode, and what drew them
Drawn = tuple[list[UInt8[np.ndarray, "height width 4"]], str]


def compare(avatar_path: str | None = None, size: int = 512) -> Findings:
    """One frame of an avatar (the built-in body) in every view mode by every way to OpenGL: EGL, OSMesa, a window.

    Equal means: no channel differs by more than 1/255 outside the pixels at the silhouette. The window is a real
    one where there is a display, and glfw's null platform with OSMesa.
    """
    from player.budget.ladder import views_of
    from player.scene.opened import opened_avatar

    avatar = opened_avatar(avatar_path or "mannequin")
    views = views_of(avatar)
    camera = orbit_camera((0, 0.0, 0), 2.6, 0.5, 0.1, (size, size))
    ways: dict[str, Callable[[], Drawn]] = {
        kind: partial(_off_screen, kind, avatar, views, camera) for kind in ("egl", "osmesa")
    }
    if os.environ.get("WAYLAND_DISPLAY") or os.environ.get("DISPLAY"):
        ways["window"] = lambda: _in_window(avatar, views, camera, null=False)
    ways["window on the null platform"] = lambda: _in_window(avatar, views, camera, null=True)
    shown: dict[str, Drawn] = {}
    lines, broken = [], []
    for way, draw in ways.items():
        try:
            shown[way] = draw()
        except AssetError as error:
            broken.append(way)
            lines.append(f"compare: {way} does not work: {error}")
    drawn = list(shown)
    pairs, worst, share = {}, 0, 0.0
    for a, b in ((drawn[0], other) for other in drawn[1:]):
        gaps = [difference(x, y) for x, y in zip(shown[a][0], shown[b][0], strict=True)]
        pairs[f"{a} - {b}"] = {view: gap for view, (gap, _) in zip(views, gaps, strict=True)}
        high, band = max(gap for gap, _ in gaps), max(part for _, part in gaps)
        worst, share = max(worst, high), max(share, band)
        pair = f"{a} ({shown[a][1]}) and {b} ({shown[b][1]})"
        outside = f"outside a one-pixel silhouette band ({100 * band:.2f} % of the pixels)"
        lines.append(f"compare: {pair}: at most {high}/255 apart in views {', '.join(views)}, {outside}")
    equal = worst <= 1 and not broken and len(drawn) > 1
    what = "equal" if equal else "NOT equal" if worst > 1 else "not all could be compared"
    lines.append(f"compare: {what}")
    facts = {"equal": equal, "worst": worst, "band": share, "ways": drawn, "broken": broken, "pairs": pairs}
    return {**facts, "text": "\n".join(lines)}


def _pose() -> tuple[np.ndarray, np.ndarray]:
    """Arms a little down and the head turned: no symmetry hides an exchange of left and right."""
    axis_angle = np.zeros((52, 3))
    axis_angle[16, 2], axis_angle[17, 2], axis_angle[15, 1] = -0.7, 0.4, 0.5
    return axis_angle, np.zeros(3)


def _off_screen(kind: str, avatar: Avatar, views: Sequence[str], camera: Camera) -> Drawn:
    from player.scene.renderer import Renderer

    with open_context(kind) as context:
        renderers = [Renderer(context, [avatar], camera.size, view=view) for view in views]
        return [renderer.draw([_pose()], camera) for renderer in renderers], context.renderer


def _in_window(avatar: Avatar, views: Sequence[str], camera: Camera, *, null: bool) -> Drawn:
    from player.scene.renderer import Renderer
    from player.window.screen import Screen

    screen = Screen(camera.size, null=null)
    try:
        (wide, high), (width, height), pictures = screen.size, camera.size, []
        if screen.size != camera.size:
            raise AssetError(f"the window has {wide}x{high} pixels, asked for {width}x{height}")
        for view in views:
            renderer = Renderer(screen.context, [avatar], None, view=view)
            renderer.draw_into(screen.begin(), [_pose()], camera)
            pictures.append(screen.read((0, 0, width, height)))
            renderer.release()
        return pictures, screen.context.renderer
    finally:
        screen.close()


def difference(a: np.ndarray, b: np.ndarray) -> tuple[int, float]:
    """Largest colour difference of two images outside a one-pixel band round their silhouettes, and its share.

    A window keeps no alpha: an image that is opaque everywhere has no silhouette, and the other's counts for both.
    """
    band = np.zeros(a.shape[:2], bool)
    for image in (a, b):
        inside = image[..., 3] > 0
        wide = np.pad(inside, 1, "edge")
        shifts = [wide[y : y + len(inside), x : x + inside.shape[1]] for y in range(3) for x in range(3)]
        band |= np.logical_or.reduce(shifts) & ~np.logical_and.reduce(shifts)
    opaque = [bool(image[..., 3].min() == 255) for image in (a, b)]
    channels = 4 if opaque[0] == opaque[1] else 3
    gap = np.abs(a[..., :channels].astype(int) - b[..., :channels]).max(-1)
    return int(gap[~band].max(initial=0)), float(band.mean())


def _version(package: str) -> str | None:
    try:
        return importlib.metadata.version(package)
    except importlib.metadata.PackageNotFoundError:
        return None
