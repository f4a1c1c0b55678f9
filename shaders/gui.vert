#version 330
// Triangles of the panels, in window coordinates from the upper left corner. player/window/panels/draw.py.

uniform vec4 window;  // left, top, width, height in window coordinates

in vec2 position;
in vec2 uv;
in vec4 color;

out vec2 place;
out vec4 tint;

void main() {
    place = uv;
    tint = color;
    vec2 part = (position - window.xy) / window.zw;
    gl_Position = vec4(2.0 * part.x - 1.0, 1.0 - 2.0 * part.y, 0.0, 1.0);
}
