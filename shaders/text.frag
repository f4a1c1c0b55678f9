#version 330
// See text.vert. White letters on a darkened plate, premultiplied alpha.

uniform sampler2D letters;

in vec2 place;

out vec4 color;

void main() {
    float ink = texture(letters, place).r;
    color = vec4(vec3(ink), max(ink, 0.5));
}
