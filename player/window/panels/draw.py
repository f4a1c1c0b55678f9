"""Dear ImGui's draw lists, drawn with moderngl: no PyOpenGL, and no state left behind.

Fonts are rasterised when a letter is first shown, so textures grow while the program runs (Dear ImGui 1.92,
`renderer_has_textures`): before drawing, each texture that asks is made, updated in parts, or freed.
"""

import ctypes
from typing import Any

import glfw  # noqa: F401  before imgui_bundle, see player/window/panels/__init__.py
import moderngl
import numpy as np
from imgui_bundle import imgui

from player.gl.context import Context
from player.gl.shader import compile_program, uniform

# texture unit, away from those of avatar, picture and text
UNIT = 5
# bytes of a buffer, so that it is rarely remade
LEAST = 1 << 16


class DrawLists:
    """Draws what `imgui.render` left, into a framebuffer."""

    def __init__(self, context: Context):
        context.make_current()
        self.context, gl = context, context.gl
        self.program = compile_program(gl, "gui.vert", "gui.frag")
        uniform(self.program, "picture").value = UNIT
        # vertices and their indices
        self.buffers = [gl.buffer(reserve=LEAST, dynamic=True) for _ in range(2)]
        self.array = self._vertex_array()
        # by the id that draw commands carry
        self.textures: dict[int, moderngl.Texture] = {}

    def _vertex_array(self) -> moderngl.VertexArray:
        vertices, indices = self.buffers
        content = [(vertices, "2f4 2f4 4f1", "position", "uv", "color")]
        return self.context.gl.vertex_array(self.program, content, indices, imgui.INDEX_SIZE)

    def draw(self, data: imgui.ImDrawData, framebuffer: moderngl.Framebuffer, size: tuple[int, int]) -> None:
        """Draw over what the framebuffer of `size` pixels holds; viewport, scissor, blending and switches come back."""
        self.context.make_current()
        for texture in data.textures:
            self._update(texture)
        left, top = data.display_pos
        wide, high = data.display_size
        if not (wide > 0 and high > 0 and size[0] > 0 and size[1] > 0):
            return
        # its types know no separate blending of alpha, and no end of a scissor
        gl: Any = self.context.gl
        target: Any = framebuffer
        scale = size[0] / wide, size[1] / high
        uniform(self.program, "window").value = (left, top, wide, high)
        viewport = framebuffer.viewport
        with gl.scope(framebuffer, moderngl.BLEND):
            framebuffer.viewport = (0, 0, *size)
            # the alpha of what is under stays full
            gl.blend_func = (
                moderngl.SRC_ALPHA, moderngl.ONE_MINUS_SRC_ALPHA, moderngl.ONE, moderngl.ONE_MINUS_SRC_ALPHA,
            )  # fmt: skip
            for commands in data.cmd_lists:
                self._upload(commands)
                for command in commands.cmd_buffer:
                    x0, y0, x1, y1 = command.clip_rect
                    box = [(x0 - left) * scale[0], (y0 - top) * scale[1], (x1 - left) * scale[0], (y1 - top) * scale[1]]
                    x0, y0, x1, y1 = (int(v) for v in np.clip(np.round(box), 0, [*size, *size]))
                    if x1 <= x0 or y1 <= y0 or not command.elem_count:
                        continue
                    target.scissor = (x0, size[1] - y1, x1 - x0, y1 - y0)
                    self.textures[command.tex_ref.get_tex_id()].use(UNIT)
                    self.array.render(vertices=command.elem_count, first=command.idx_offset)
            target.scissor = None
            gl.blend_func = moderngl.DEFAULT_BLENDING
        framebuffer.viewport = viewport

    def _upload(self, commands: imgui.ImDrawList) -> None:
        made = False
        for k, (source, size) in enumerate(
            ((commands.vtx_buffer, imgui.VERTEX_SIZE), (commands.idx_buffer, imgui.INDEX_SIZE))
        ):
            count, buffer = source.size() * size, self.buffers[k]
            if count > buffer.size:
                buffer.release()
                buffer = self.buffers[k] = self.context.gl.buffer(reserve=2 * count, dynamic=True)
                made = True
            elif count:
                # the list before may still be read
                buffer.orphan()
            if count:
                buffer.write(ctypes.string_at(source.data_address(), count))
        if made:
            self.array.release()
            self.array = self._vertex_array()

    def _update(self, data: imgui.ImTextureData) -> None:
        """What a texture asks for: to be made, to get new letters, to be freed."""
        asked = data.status
        if asked in (imgui.ImTextureStatus.ok, imgui.ImTextureStatus.destroyed):
            return
        if asked == imgui.ImTextureStatus.want_destroy:
            if data.unused_frames > 0:  # else it is still in this frame's lists
                self._free(data)
            return
        assert data.format == imgui.ImTextureFormat.rgba32, "only textures of four bytes a texel are asked for"
        pixels = data.get_pixels_array().reshape(data.height, data.width, 4)
        if asked == imgui.ImTextureStatus.want_create:
            texture = self.context.gl.texture((data.width, data.height), 4, pixels.tobytes())
            texture.filter = (moderngl.LINEAR, moderngl.LINEAR)
            texture.repeat_x = texture.repeat_y = False
            self.textures[texture.glo] = texture
            data.set_tex_id(texture.glo)
        else:
            texture = self.textures[data.tex_id]
            for part in data.updates:
                rows = pixels[part.y : part.y + part.h, part.x : part.x + part.w]
                texture.write(rows.tobytes(), viewport=(part.x, part.y, part.w, part.h))
        data.set_status(imgui.ImTextureStatus.ok)

    def _free(self, data: imgui.ImTextureData) -> None:
        texture = self.textures.pop(data.tex_id, None)
        if texture is not None:
            texture.release()
        data.set_tex_id(0)
        data.set_status(imgui.ImTextureStatus.destroyed)

    def release(self) -> None:
        """Free everything; Dear ImGui's context must still exist; its textures are marked as freed."""
        self.context.make_current()
        self.context.leave_framebuffer()
        for data in imgui.get_platform_io().textures:
            if data.ref_count == 1:
                self._free(data)
        for thing in (self.array, *self.buffers, self.program, *self.textures.values()):
            thing.release()
        self.textures = {}
