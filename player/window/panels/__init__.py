"""All text and widgets of the window: Dear ImGui (imgui-bundle, the extra `gui`), drawn by our own moderngl code.

glfw is imported before imgui_bundle, which brings a glfw of its own and would else hide functions of ours.
"""
