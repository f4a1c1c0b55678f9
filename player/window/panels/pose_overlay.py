"""What posing draws over the avatar: the rings on the selected joint (ImGuizmo), handles of hands, feet and body, dots
of the joints."""

import numpy as np
from imgui_bundle import imgui
from imgui_bundle.imguizmo import im_guizmo
from jaxtyping import Float

from avatar.camera import clip_from_view, project, view_from_world
from avatar.skeleton import PARENTS
from player.window.pose_tool import HANDLES, PoseTool, PullHandle
from player.window.posing import PoseEdit
from player.window.state import WindowState

HELD = imgui.IM_COL32(255, 214, 64, 255)
BONE = imgui.IM_COL32(255, 255, 255, 60)
DOT = imgui.IM_COL32(255, 255, 255, 130)
HANDLE = imgui.IM_COL32(255, 150, 40, 235)
PINNED = imgui.IM_COL32(70, 200, 220, 235)
BODY = imgui.IM_COL32(240, 240, 240, 200)
INK = imgui.IM_COL32(0, 0, 0, 200)
# window units from wrist to finger tip from which the fingers' joints are shown
FEWEST = 40.0
# how large the rings are, window units; fingers are small
RADIUS, FINGER_RADIUS = 75.0, 41.0


def pose_overlay(tool: PoseTool, state: WindowState) -> None:
    """All of it, for the avatar that is being posed."""
    if state.last.camera is None:
        return
    draw = imgui.get_background_draw_list()
    pixels, depth = project(state.last.camera, tool.session.world()[:, :3, 3])
    # window units
    places, ahead = pixels / state.layout.screen.pixel(1.0, 1.0), depth > 1e-3
    # the larger of the two hands on the screen, wrist to last joint of the middle finger
    hand = np.linalg.norm(places[[20, 21]] - places[[27, 42]], axis=1).max()
    fingers = np.ptp(places[20:52], axis=0).max() > 0 and hand > FEWEST
    for joint in range(1, 52 if fingers else 22):
        if ahead[joint] and ahead[PARENTS[joint]]:
            draw.add_polyline(places[[PARENTS[joint], joint]].tolist(), BONE, 1.0, 0)
    for joint in range(22):
        if ahead[joint]:
            draw.add_circle_filled(places[joint].tolist(), 2.5, DOT)
    for handle in HANDLES:
        if ahead[handle.joint]:
            _handle(draw, tool, handle, places[handle.joint])


def _handle(draw: imgui.ImDrawList, tool: PoseTool, handle: PullHandle, place: Float[np.ndarray, "2"]) -> None:
    """A square at hands and feet (blue when pinned), a diamond for the body, a small ring at elbows and knees."""
    held = tool.held is not None and tool.held.handle is handle
    lit = held or tool.hovered is handle
    if handle.kind == "middle":
        draw.add_circle(place.tolist(), 6.0 if lit else 4.5, HELD if lit else HANDLE, 0, 2.0)
        return
    size = 8.0 if lit else 6.0
    corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * size
    color = PINNED if handle.name in tool.session.pinned else HANDLE
    if handle.kind == "body":
        corners, color = np.array([[0, -1], [1, 0], [0, 1], [-1, 0]]) * (size + 2), BODY
    shape = (place + corners).tolist()
    draw.add_convex_poly_filled(shape, HELD if lit else color)
    draw.add_polyline(shape, INK, 1.0, imgui.ImDrawFlags_.closed)


def rings(edit: PoseEdit, state: WindowState) -> None:
    """ImGuizmo's rings on the selected joint, drawn and dragged; red, green and blue turn about the axes of
    `PoseTool.ring_axes`, the outer one in the picture's plane."""
    tool, camera, joint = edit.tool, state.last.camera, edit.tool.joint
    im_guizmo.begin_frame()
    if tool.given_up:
        # it lets go of what it holds when it is switched off
        im_guizmo.enable(False)
        im_guizmo.enable(True)
    tool.given_up = tool.given_up and imgui.is_mouse_down(0)
    if camera is None or joint is None or tool.given_up:
        tool.on_ring = False
        return
    wide, high = imgui.get_io().display_size
    world_from_rings = np.eye(4)
    world_from_rings[:3, :3], world_from_rings[:3, 3] = tool.ring_axes(), tool.session.world()[joint, :3, 3]
    edited = _matrix(world_from_rings)
    im_guizmo.set_drawlist(imgui.get_background_draw_list())
    im_guizmo.set_rect(0.0, 0.0, wide, high)
    im_guizmo.set_gizmo_size_clip_space(2 * (RADIUS if joint < 22 else FINGER_RADIUS) / max(wide, 1.0))
    im_guizmo.manipulate(
        _matrix(view_from_world(camera)), _matrix(clip_from_view(camera, 0.01, 100.0)), im_guizmo.OPERATION.rotate,
        im_guizmo.MODE.local, edited,
    )  # fmt: skip
    using = im_guizmo.is_using()
    tool.on_ring = using or im_guizmo.is_over()
    if using:
        tool.turn(np.array(edited.values, np.float64).reshape(4, 4)[:3, :3].T)
    elif tool.held is not None and tool.held.handle is None:
        tool.release()


def _matrix(matrix: Float[np.ndarray, "4 4"]) -> im_guizmo.Matrix16:
    """A matrix as ImGuizmo takes it, by columns."""
    return im_guizmo.Matrix16(matrix.T.reshape(-1).tolist())
