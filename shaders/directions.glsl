// View directions in the canonical frame: the direction rule of avatar/skinning.py, blended_rotations.
//
//     q = normalise(sum_k w_k s_k q_k),  s_k = +-1 puts q_k in the hemisphere of the heaviest bone
//     d_canonical = R(q)^T d_view
//
// The blend stays orthonormal where the blended matrix flattens (a forearm twisted by 180 degrees), and cannot
// vanish: the heaviest term has weight >= 1/4 and no other term points away from it. joints.x is the heaviest
// bone; the loader sorts. Quaternions are xyzw.
#include "bone_count.glsl"
#include "influence_count.glsl"

// rotations of the bones of the one avatar that is drawn; mirrored by player/gl/blocks.py, TURNS
layout(std140) uniform Turns {
    vec4 view_from_canonical_q[BONE_COUNT];
};

vec4 turn_of(uint joint) {
    return view_from_canonical_q[joint];
}

vec4 blended_turn(uvec4 joints, vec4 weights) {
    vec4 heaviest = turn_of(joints.x);
    vec4 sum = weights.x * heaviest;
    vec4 q;
    if (INFLUENCES > 1) {
        q = turn_of(joints.y);
        sum += (dot(q, heaviest) < 0.0 ? -weights.y : weights.y) * q;
    }
    if (INFLUENCES > 2) {
        q = turn_of(joints.z);
        sum += (dot(q, heaviest) < 0.0 ? -weights.z : weights.z) * q;
    }
    if (INFLUENCES > 3) {
        q = turn_of(joints.w);
        sum += (dot(q, heaviest) < 0.0 ? -weights.w : weights.w) * q;
    }
    return normalize(sum);
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
