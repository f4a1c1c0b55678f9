"""The panel of cameras: which one is looked through, keys of a path, and the wipe against the source video."""

from imgui_bundle import imgui

from avatar.progress import counted
from player.cameras import NAMES
from player.gui.widgets import Widgets, tip_of
from player.window.actions import ADD_CAMERA_KEY, FIRST_PERSON, FOLLOW, RESET_CAMERA, SAVE_CAMERA_PATH
from player.window.parts import Parts
from player.window.viewpoint import Viewpoint
from player.window.wipe import Wipe


def camera_panel(ui: Widgets, parts: Parts) -> None:
    """The camera, and what belongs to its kind."""
    viewpoint = parts.viewpoint
    cameras, kinds = viewpoint.cameras, viewpoint.cameras.kinds
    tip = "What the picture is seen through. Key: c takes the next."
    chosen = ui.choice("camera", kinds.index(cameras.kind), [NAMES.get(kind, kind) for kind in kinds], tip)
    if chosen is not None:
        viewpoint.choose(kinds[chosen])
    if cameras.kind in ("orbit", "turntable"):
        ui.action("Reset", RESET_CAMERA, parts, name="reset camera")
        viewpoint.follow = ui.checkbox(
            "follow the avatar", viewpoint.follow, tip_of(FOLLOW), name="follow", beside=True
        )
    elif cameras.kind == "walk":
        imgui.text_disabled("\n".join(f"{action.shown_keys[0]}  {action.means}" for action in FIRST_PERSON.actions))
    if parts.wipe is not None and viewpoint.shows_video:
        _wipe(ui, parts.wipe, viewpoint)
    ui.action("Add camera key", ADD_CAMERA_KEY, parts, name="add key")
    if cameras.keys:
        ui.action("Save path", SAVE_CAMERA_PATH, parts, beside=True)
        if ui.button("Clear", "Forget the recorded keys.", name="clear keys", beside=True):
            cameras.clear_keys()
    if cameras.keys:
        imgui.text_disabled(f"{counted(len(cameras.keys), 'camera key')}, the last at {cameras.keys[-1][0]:.2f} s")


def _wipe(ui: Widgets, wipe: Wipe, viewpoint: Viewpoint) -> None:
    tip = "How much of the width shows the video alone. Drag the yellow line in the picture, or press - and =."
    part = ui.slider("wipe", wipe.part, (0.0, 1.0), tip, form="video | avatar")
    if part is not None:
        wipe.move(part)
    tip = "On: the video is behind the avatar too. Off: the plain background is."
    wipe.behind = ui.checkbox("video behind the avatar", wipe.behind, tip, name="behind")
    imgui.text_disabled(f"{wipe.capture.part} video, picture {viewpoint.video_frame}")
