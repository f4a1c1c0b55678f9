#version 330
// The cells of the ground that a body's capsules can darken: corners of a grid, of which player/effects/contact.py
// lists the triangles. What is high above the ground hides the sky smoothly from cell to cell: it is looked at here.
#include "contact.glsl"

const int CELLS = 24;  // each way; mirrored there

uniform vec4 clip_from_plane[3];  // as in plane.vert
uniform vec2 across;              // of the grid, metres
uniform vec3 view_from_plane[3];  // of x, of z, of the anchor
uniform vec3 up;                  // of the world, in view space
uniform float grown;
uniform ivec2 high;  // of the capsules: the first that is high, and the end of all

out vec2 place;    // x, z about the anchor, metres
out float beyond;  // what the high ones leave open

void main() {
    place = across * vec2(gl_VertexID % (CELLS + 1), gl_VertexID / (CELLS + 1)) / float(CELLS);
    gl_Position = clip_from_plane[0] * place.x + clip_from_plane[1] * place.y + clip_from_plane[2];
    vec3 p = view_from_plane[0] * place.x + view_from_plane[1] * place.y + view_from_plane[2];
    beyond = open_sky(p, up, 0u, grown, high.x, high.y);
}
