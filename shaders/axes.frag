#version 330
// See axes.vert. Opaque.

flat in vec3 paint;

out vec4 color;

void main() {
    color = vec4(paint, 1.0);
}
