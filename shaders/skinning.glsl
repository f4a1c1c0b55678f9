// Linear blend skinning:  x_view = (sum_k w_k V B_k) x_canonical,  V the camera's view_from_world.
// The same one matrix as avatar/skinning.py, skin_points.
// Weights are four bytes that sum to 255; the loader refused all others, nothing is normalised here.
#include "counts.glsl"

// of the one avatar that is drawn; mirrored by player/gl/blocks.py, BONES
layout(std140, row_major) uniform Bones {
    mat4x3 view_from_canonical[BONE_COUNT];
};

vec3 skinned(vec3 point, uvec4 joints, vec4 weights) {
    mat4x3 blended = weights.x * view_from_canonical[joints.x];
    if (INFLUENCES > 1) blended += weights.y * view_from_canonical[joints.y];
    if (INFLUENCES > 2) blended += weights.z * view_from_canonical[joints.z];
    if (INFLUENCES > 3) blended += weights.w * view_from_canonical[joints.w];
    return blended * vec4(point, 1.0);
}
