#version 330
// What a body's capsules hide of the sky above the ground, as black, premultiplied.
#include "contact.glsl"

uniform vec3 view_from_plane[3];  // of x, of z, of the anchor
uniform vec3 up;                  // of the world, in view space
uniform float strength;
uniform float grown;
uniform int count;  // of the low capsules, those that a cell is near

in vec2 place;
in float beyond;

out vec4 color;

void main() {
    vec3 p = view_from_plane[0] * place.x + view_from_plane[1] * place.y + view_from_plane[2];
    color = vec4(0.0, 0.0, 0.0, strength * (1.0 - beyond * open_sky(p, up, 0u, grown, 0, count)));
}
