// Linear blend skinning of 52 bones:  x_view = (sum_k w_k V B_k) x_canonical,  V the camera's view_from_world.
// Mirrored by player/blocks.py, BONES. The same one matrix as avatar/skinning.py, skin_points.
// Weights are four bytes that sum to 255; the loader refused all others, nothing is normalised here.
layout(std140, row_major) uniform Bones {
    mat4x3 view_from_canonical[52];
};

vec3 skinned(vec3 point, uvec4 joints, vec4 weights) {
    mat4x3 blended = weights.x * view_from_canonical[joints.x] + weights.y * view_from_canonical[joints.y]
                   + weights.z * view_from_canonical[joints.z] + weights.w * view_from_canonical[joints.w];
    return blended * vec4(point, 1.0);
}
