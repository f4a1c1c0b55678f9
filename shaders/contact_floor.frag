#version 330
// What a body's capsules hide of the sky above the ground, on a texture of it: it changes over no less than a capsule's
// radius, a few texels. laid.frag lays it on the ground.
#include "contact.glsl"

uniform vec2 texel;               // metres
uniform vec3 view_from_plane[3];  // of x, of z, of the anchor
uniform vec3 up;                  // of the world, in view space
uniform float grown;
uniform int count;  // of capsules

out float hidden;

void main() {
    vec2 place = texel * gl_FragCoord.xy;
    vec3 p = view_from_plane[0] * place.x + view_from_plane[1] * place.y + view_from_plane[2];
    hidden = 1.0 - open_sky(p, up, 0u, grown, 0, count);
}
