#version 330
// One colour, opaque: what has a shape and no paint.

uniform vec3 plain;  // sRGB

out vec4 color;

void main() {
    color = vec4(plain, 1.0);
}
