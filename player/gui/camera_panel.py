"""The panel of cameras: which one is looked through, keys of a path, and the wipe against the source video."""

from typing import TYPE_CHECKING

from imgui_bundle import imgui

from player.cameras import NAMES

if TYPE_CHECKING:
    from player.window.window import Window


def camera_panel(window: "Window") -> None:
    """The camera, and what belongs to its kind."""
    cameras, panels = window.cameras, window.panels
    assert panels is not None
    kinds = cameras.kinds
    changed, chosen = imgui.combo("camera", kinds.index(cameras.kind), [NAMES.get(kind, kind) for kind in kinds])
    panels.mark("camera")
    if changed:
        cameras.choose(kinds[chosen], window.area_camera())
    if cameras.kind in ("orbit", "turntable"):
        if imgui.button("Reset"):
            cameras.orbit.reset()
        panels.mark("reset camera")
        imgui.same_line()
        _, window.follow = imgui.checkbox("follow the avatar", window.follow)
        panels.mark("follow")
    elif cameras.kind == "walk":
        imgui.text_disabled("w a s d go, e q up and down, drag looks")
    wipe = window.wipe
    if wipe is not None and cameras.kind == "capture":
        changed, part = imgui.slider_float("wipe", wipe.part, 0.0, 1.0, "video | avatar")
        panels.mark("wipe")
        if changed:
            wipe.move(part)
        _, wipe.behind = imgui.checkbox("video behind the avatar", wipe.behind)
        panels.mark("behind")
        imgui.text_disabled(f"{wipe.capture.part} video, picture {window.video_frame()}")
    if imgui.button("Add key"):
        window.add_key()
    panels.mark("add key")
    if cameras.keys:
        imgui.same_line()
        if imgui.button("Save path"):
            window.save_path()
        panels.mark("save path")
        imgui.same_line()
        if imgui.button("Clear"):
            cameras.clear_keys()
        panels.mark("clear keys")
        imgui.text_disabled(f"{len(cameras.keys)} keys, the last at {cameras.keys[-1][0]:.2f} s")
