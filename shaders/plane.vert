#version 330
// A rectangle of a level plane. Mirrored by player/effects/ground_plane.py, which multiplies in double precision.

uniform vec4 clip_from_plane[3];  // of x, of z, of the anchor
uniform vec4 reach;               // x0, z0, x1, z1 about the anchor, metres

out vec2 place;  // x, z about the anchor, metres
out vec2 at;     // the same as a share of the rectangle, [0,1]

void main() {
    at = vec2(gl_VertexID & 1, gl_VertexID >> 1);
    place = mix(reach.xy, reach.zw, at);
    gl_Position = clip_from_plane[0] * place.x + clip_from_plane[1] * place.y + clip_from_plane[2];
}
