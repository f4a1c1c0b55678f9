// View directions in the canonical frame: the direction rule of avatar/skinning.py, blended_rotations.
//
//     q = normalise(sum_k w_k s_k q_k),  s_k = +-1 puts q_k in the hemisphere of the heaviest bone
//     d_canonical = R(q)^T d_view
//
// The blend stays orthonormal where the blended matrix flattens (a forearm twisted by 180 degrees), and cannot
// vanish: the heaviest term has weight >= 1/4 and no other term points away from it. joints.x is the heaviest
// bone; the loader sorts. Quaternions are xyzw.
#include "counts.glsl"

// rotations of the bones of the one avatar that is drawn; mirrored by player/gl/blocks.py, TURNS
layout(std140) uniform Turns {
    vec4 view_from_canonical_q[BONE_COUNT];
};

// w_k s_k
vec4 signed_weights(uvec4 joints, vec4 weights) {
    vec4 heaviest = view_from_canonical_q[joints.x];
    if (INFLUENCES > 1 && dot(view_from_canonical_q[joints.y], heaviest) < 0.0) weights.y = -weights.y;
    if (INFLUENCES > 2 && dot(view_from_canonical_q[joints.z], heaviest) < 0.0) weights.z = -weights.z;
    if (INFLUENCES > 3 && dot(view_from_canonical_q[joints.w], heaviest) < 0.0) weights.w = -weights.w;
    return weights;
}

// sum_k w_k q_k, of signed weights
vec4 summed_turns(uvec4 joints, vec4 weights) {
    vec4 sum = weights.x * view_from_canonical_q[joints.x];
    if (INFLUENCES > 1) sum += weights.y * view_from_canonical_q[joints.y];
    if (INFLUENCES > 2) sum += weights.z * view_from_canonical_q[joints.z];
    if (INFLUENCES > 3) sum += weights.w * view_from_canonical_q[joints.w];
    return sum;
}

vec4 blended_turn(uvec4 joints, vec4 weights) {
    return normalize(summed_turns(joints, signed_weights(joints, weights)));
}

// R(q)^T v:  v + 2 q_w (v x q) + 2 (v x q) x q
vec3 turned_back(vec4 q, vec3 v) {
    vec3 c = 2.0 * cross(v, q.xyz);
    return v + q.w * c + cross(c, q.xyz);
}

// v / |v|, and 0 for 0. The floor keeps 1/0 away from a vertex that sits on the eye.
vec3 unit(vec3 v) {
    return v * inversesqrt(max(dot(v, v), 1e-20));
}
