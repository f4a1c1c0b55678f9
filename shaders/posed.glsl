// An avatar's vertex in its pose, view space, metres. SKINNING: 0 linear blend, 1 dual quaternions. LOOSE, FACE: 1 hair
// and skirts, the face move.
#if SKINNING == 0
#include "skinning.glsl"
#else
#include "skinning_dual.glsl"
#endif
#include "face.glsl"

in vec3 position;  // canonical (big pose), metres
in uvec4 joints;   // heaviest first
in vec4 weights;   // sum to 1

#if LOOSE != 0
#include "loose.glsl"
in uvec4 near_particles;
in vec4 follows;
#endif

vec3 posed() {
    vec3 point = skinned(faced(position), joints, weights);
#if LOOSE != 0
    point += loosened(near_particles, follows);
#endif
    return point;
}

// A canonical normal by the same blend as the point, not of length 1: skinned(x + n) - skinned(x) is linear in n for
// either SKINNING.
vec3 posed_normal(vec3 normal) {
    vec3 point = faced(position);
    return skinned(point + faced_normal(normal), joints, weights) - skinned(point, joints, weights);
}
