"""What posing draws over the avatar: rings of the gizmo, handles of hands, feet and body, dots of the joints."""

import numpy as np
from imgui_bundle import imgui
from jaxtyping import Float

from avatar.camera import Camera, project
from avatar.skeleton import PARENTS
from player.pose.gizmo import VIEW_RING, Gizmo, ring_front, ring_points
from player.window.pose_tool import HANDLES, PoseTool, PullHandle
from player.window.state import WindowState

COLORS = (
    (230, 70, 70),
    (95, 200, 80),
    (80, 140, 250),
    (215, 215, 215),
)  # flexion, abduction, twist; the view
HELD = (255, 214, 64)
BONE = imgui.IM_COL32(255, 255, 255, 60)
DOT = imgui.IM_COL32(255, 255, 255, 130)
HANDLE = imgui.IM_COL32(255, 150, 40, 235)
PINNED = imgui.IM_COL32(70, 200, 220, 235)
BODY = imgui.IM_COL32(240, 240, 240, 200)
INK = imgui.IM_COL32(0, 0, 0, 200)
# window units from wrist to finger tip from which the fingers' joints are shown
FEWEST = 40.0


class OverlayCanvas:
    """Draws over the picture with imgui; projects world points to window units."""

    def __init__(self, camera: Camera, units: tuple[float, float]):
        self.camera, self.units = camera, units
        self.draw = imgui.get_background_draw_list()

    def points(self, world: Float[np.ndarray, "n 3"]) -> tuple[Float[np.ndarray, "n 2"], Float[np.ndarray, "n"]]:
        pixels, depth = project(self.camera, world)
        return pixels / self.units, depth

    def stroke(self, points: Float[np.ndarray, "n 2"], color: int, width: float) -> None:
        if len(points) > 1:
            self.draw.add_polyline(_vectors(points), color, width, 0)


def pose_overlay(tool: PoseTool, state: WindowState) -> None:
    """All of it, for the avatar that is being posed."""
    if state.last.camera is None:
        return
    paper = OverlayCanvas(state.last.camera, state.layout.screen.pixel(1.0, 1.0))
    places, depth = paper.points(tool.session.world()[:, :3, 3])
    ahead = depth > 1e-3
    fingers = np.ptp(places[20:52], axis=0).max() > 0 and _hand_size(places) > FEWEST
    for joint in range(1, 52 if fingers else 22):
        if ahead[joint] and ahead[PARENTS[joint]]:
            paper.stroke(places[[PARENTS[joint], joint]], BONE, 1.0)
    for joint in range(22):
        if ahead[joint]:
            paper.draw.add_circle_filled(imgui.ImVec2(*map(float, places[joint])), 2.5, DOT)
    for handle in HANDLES:
        if ahead[handle.joint]:
            _handle(paper, tool, handle, places[handle.joint])
    gizmo = tool.gizmo()
    if gizmo is not None:
        _rings(paper, tool, gizmo)


def _hand_size(places: Float[np.ndarray, "52 2"]) -> float:
    """The larger of the two hands on the screen, wrist to last joint of the middle finger."""
    return float(max(np.linalg.norm(places[20] - places[27]), np.linalg.norm(places[21] - places[42])))


def _handle(paper: OverlayCanvas, tool: PoseTool, handle: PullHandle, place: Float[np.ndarray, "2"]) -> None:
    """A square at hands and feet (blue when pinned), a diamond for the body, a small ring at elbows and knees."""
    held = tool.held is not None and tool.held.handle is handle
    lit = held or tool.hovered is handle
    center, draw = imgui.ImVec2(*map(float, place)), paper.draw
    if handle.kind == "middle":
        draw.add_circle(center, 6.0 if lit else 4.5, _color(HELD, 255) if lit else HANDLE, 0, 2.0)
        return
    size = 8.0 if lit else 6.0
    corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * size
    color = PINNED if handle.name in tool.session.pinned else HANDLE
    if handle.kind == "body":
        corners, color = np.array([[0, -1], [1, 0], [0, 1], [-1, 0]]) * (size + 2), BODY
    shape = _vectors(place + corners)
    draw.add_convex_poly_filled(shape, _color(HELD, 255) if lit else color)
    draw.add_polyline(shape, INK, 1.0, imgui.ImDrawFlags_.closed)


def _rings(paper: OverlayCanvas, tool: PoseTool, gizmo: Gizmo) -> None:
    """Near halves bold, far halves faint; the ring that is held with the angle it was turned by."""
    held = tool.held.grab.ring if tool.held is not None and tool.held.grab is not None else None
    for ring in (VIEW_RING, 0, 1, 2):
        world = ring_points(gizmo, ring)
        points, depth = paper.points(world)
        front = ring_front(gizmo, world, paper.camera) | (ring == VIEW_RING)
        lit = ring in (held, tool.hovered)
        color = HELD if lit else COLORS[ring]
        for near in (False, True):
            for run in _runs((front == near) & (depth > 1e-3)):
                width = (3.5 if lit else 2.5) if near and ring != VIEW_RING else 1.5
                paper.stroke(points[run], _color(color, 255 if near else 70), width)
    if held is None or tool.held is None or tool.held.grab is None:
        return
    grab, angle = tool.held.grab, tool.held.angle
    axis, start = gizmo.axes[held], grab.start * gizmo.radii[held]
    turn = np.linspace(0, np.clip(angle, -6.2, 6.2), 48)[:, None]
    sector = gizmo.center + np.cos(turn) * start + np.sin(turn) * np.cross(axis, start)
    points, depth = paper.points(np.concatenate([gizmo.center[None], sector]))
    if (depth > 1e-3).all():
        paper.draw.add_concave_poly_filled(_vectors(points), _color(HELD, 50))
        paper.stroke(points[[0, 1]], _color(HELD, 200), 1.5)
        paper.stroke(points[[0, -1]], _color(HELD, 255), 1.5)
        at = points[-1] + [10.0, -10.0]
        text = f"{np.degrees(angle):+.1f} deg"
        for shift, ink in ((1.0, INK), (0.0, _color(HELD, 255))):
            paper.draw.add_text(imgui.ImVec2(float(at[0] + shift), float(at[1] + shift)), ink, text)


def _runs(chosen: np.ndarray) -> list[slice]:
    """Stretches of True, each as a slice."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], chosen.astype(np.int8), [0]])))
    return [slice(int(a), int(b)) for a, b in zip(edges[::2], edges[1::2], strict=True)]


def _vectors(points: Float[np.ndarray, "n 2"]) -> list:
    return [imgui.ImVec2(float(x), float(y)) for x, y in points]


def _color(rgb: tuple[int, int, int], alpha: int) -> int:
    return imgui.IM_COL32(*rgb, alpha)
