#version 330
// See text.vert. Letters on their plate, premultiplied alpha.

uniform sampler2D plate;

in vec2 place;

out vec4 color;

void main() {
    color = texture(plate, place);
}
