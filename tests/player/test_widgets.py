"""What a user of the panels is told: tooltips of all widgets, keys on the screen, files whose names can be read."""

import ast
import inspect
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("imgui_bundle", reason="the extra gui is not installed")

import glfw  # noqa: F401  before imgui_bundle

import avatar
import player.window
import player.window.panels
from player.window.actions import GROUPS
from player.window.panels import widgets
from player.window.panels.widgets import Widgets, elided
from tests.window_script import run

FOLDER = Path(player.window.panels.__file__).parent
INTERACTIVE = (
    "button", "checkbox", "combo", "begin_combo", "selectable", "collapsing_header", "tree_node",
    "slider_float", "slider_int", "drag_float", "drag_float3", "input_text", "input_text_with_hint", "input_float",
    "color_edit3", "radio_button", "menu_item",
)  # fmt: skip


def test_panels_reach_interactive_widgets_only_where_a_tooltip_is_asked_for():
    """Every method of Widgets that makes one has a `tip` or an action that has no default."""
    for file in FOLDER.glob("*.py"):
        if file.name == "widgets.py":
            continue
        calls = {
            node.func.attr
            for node in ast.walk(ast.parse(file.read_text("utf-8")))
            if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute)
            and isinstance(node.func.value, ast.Name) and node.func.value.id == "imgui"
        }  # fmt: skip
        assert calls.isdisjoint(INTERACTIVE), (file.name, calls & set(INTERACTIVE))
    source = inspect.getsource(widgets)
    used = [name for name in INTERACTIVE if f"imgui.{name}(" in source]
    assert len(used) > 10
    for name, method in inspect.getmembers(Widgets, inspect.isfunction):
        if any(f"imgui.{word}(" in inspect.getsource(method) for word in INTERACTIVE):
            needed = {p.name for p in inspect.signature(method).parameters.values() if p.default is p.empty}
            assert needed & {"tip", "action"}, name


@pytest.fixture
def opened(open_window):
    """Opens windows with panels, paused at the first frame."""
    return lambda *more: open_window(*more, size=(1280, 800), script="space home wait")


def test_every_widget_has_a_tooltip_of_its_own_and_it_is_shown(opened):
    window = opened()
    window.parts.state.selection.choose(0, 18)
    run(window, "p k press:left_fingers wait wait")
    tips = window.panels.ui.tips
    assert len(tips) > 80 and all(len(tip) > 5 for tip in tips.values())
    words = [tip for name, tip in tips.items() if not name.startswith("path")]
    assert len(set(words)) == len(words)
    assert "Play or pause.\nKey: space" in words
    # buttons of actions show their keys as the table has them
    means = {action.means: action for group in GROUPS for action in group.actions}
    shown = [tip.partition(".\nKey: ")[0] for tip in words if ".\nKey: " in tip]
    assert {text[0].lower() + text[1:] for text in shown} <= means.keys() and len(shown) > 15
    x, y = window.panels.places["play"]
    plain = run(window, "move:640:100 wait wait")
    resting = run(window, f"move:{x}:{y} " + "wait " * 25)
    beside = np.s_[int(y) - 90 : int(y) - 20, int(x) : int(x) + 180]
    above = np.abs(resting - plain)[beside].max(-1) > 60
    below = np.abs(resting - plain)[int(y) + 15 :, int(x) : int(x) + 180].max(-1) > 60
    assert above.sum() + below.sum() > 100


@pytest.mark.parametrize("key", ["h", "f1", "press:keys"])
def test_the_list_of_keys_is_shown_over_panels_and_goes_away(opened, key):
    window = opened()
    before = run(window, "move:640:100 wait")
    listed = run(window, f"{key} move:640:100 wait")
    middle = np.s_[300:500, 400:900]
    assert (np.abs(listed - [255, 204, 51]).max(-1) < 40)[:, 100:1180].sum() > 500
    assert (listed[middle] < 40).all(-1).mean() > 0.7
    closed = run(window, "escape wait")
    assert not window.parts.closing
    assert np.array_equal(closed[middle], before[middle])


def test_saving_a_pose_is_in_sight_and_few_attributes_are_on_each_object(opened):
    window = opened()
    run(window, "p wait wait")
    low = window.parts.state.layout.area[3]
    for name in ("save", "load", "file", "undo", "joint", "left fist", "pin left foot"):
        assert window.panels.places[name][1] < low - 8, name
    parts = window.parts
    for thing in (
        window, window.screen, window.pointer, window.keyboard, window.panels, parts, parts.state, parts.state.layout,
        parts.viewpoint, parts.look, parts.posing, parts.posing.edit, parts.posing.edit.tool, parts.recorder,
    ):  # fmt: skip
        assert len(vars(thing)) <= 12, (type(thing).__name__, sorted(vars(thing)))


def test_of_a_long_path_the_name_is_in_sight_and_the_middle_goes_last(opened, tmp_path, monkeypatch):
    folder = tmp_path / "a_folder_with_quite_a_long_name" / "and_another_one_in_it" / "and_a_last_one"
    folder.mkdir(parents=True)
    path = folder / "my_motion.npz"
    path.write_bytes((Path(avatar.__file__).parent / "data" / "motions" / "counting.npz").read_bytes())
    window = opened("--motion", str(path))
    assert window.panels.ui.tips["path motion"] == str(path)
    monkeypatch.setattr(widgets.imgui, "calc_text_size", lambda text: widgets.imgui.ImVec2(float(len(text)), 1.0))
    path = "/home/someone/motions/walking/slowly.bvh"
    assert elided(path, 99.0) == path
    assert elided(path, 25.0) == ".../walking/slowly.bvh"
    assert elided(path, 14.0) == ".../slowly.bvh"
    cut = elided(path, 9.0)
    assert len(cut) == 9 and cut.startswith("sl") and cut.endswith(".bvh") and "..." in cut
    assert elided("counting", 20.0) == "counting"
