#version 330
// A posed avatar as its lamp throws it on the ground: where, and how high above it. SKINNING as in posed.glsl.
#include "posed.glsl"

uniform vec4 mask_from_view[3];  // rows: across and along the mask in [-1,1], height in [0,1]

out float height;

void main() {
    vec4 point = vec4(posed(), 1.0);
    gl_Position = vec4(dot(mask_from_view[0], point), dot(mask_from_view[1], point), 0.0, 1.0);
    height = dot(mask_from_view[2], point);
}
