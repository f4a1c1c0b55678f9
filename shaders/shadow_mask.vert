#version 330
// A posed avatar as its lamp throws it on the ground: where, and how high above it. SKINNING as in avatar.vert.
#if SKINNING == 0
#include "skinning.glsl"
#else
#include "skinning_dual.glsl"
#endif
#include "face.glsl"

#if LOOSE != 0
#include "loose.glsl"

in uvec4 near_particles;
in vec4 follows;
#endif

uniform vec4 mask_from_view[3];  // rows: across and along the mask in [-1,1], height in [0,1]

in vec3 position;  // canonical (big pose), metres
in uvec4 joints;   // heaviest first
in vec4 weights;   // sum to 1

out float height;

void main() {
    vec4 point = vec4(skinned(faced(position), joints, weights), 1.0);
#if LOOSE != 0
    point.xyz += loosened(near_particles, follows);
#endif
    gl_Position = vec4(dot(mask_from_view[0], point), dot(mask_from_view[1], point), 0.0, 1.0);
    height = dot(mask_from_view[2], point);
}
