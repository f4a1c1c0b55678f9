#version 330
// See gui.vert. Straight alpha, as Dear ImGui's textures and colours have it.

uniform sampler2D picture;

in vec2 place;
in vec4 tint;

out vec4 color;

void main() {
    color = tint * texture(picture, place);
}
