// Dual quaternion skinning (Kavan et al. 2008): bones blend as screws, so a twisted limb keeps its radius, where
// linear blending thins it to cos(angle / 2) and to nothing at a half turn.
//
//     (r, d) = sum_k w_k s_k (q_k, t_k q_k / 2)    s_k = +-1 puts q_k in the hemisphere of the heaviest bone
//     x_view = R(r) x + 2 d r* / |r|^2
//
// The same sign rule and the same rotations as directions.glsl, whose Turns hold q_k; it mirrors avatar/skinning.py,
// skin_points_dual_quaternion. |r| >= 1/4: see directions.glsl. xyzw.
#include "directions.glsl"

// t q / 2 of the bones of the one avatar that is drawn, xyzw; mirrored by player/gl/blocks.py, DUALS
layout(std140) uniform Duals {
    vec4 view_from_canonical_d[BONE_COUNT];
};

vec3 skinned(vec3 point, uvec4 joints, vec4 weights) {
    vec4 w = signed_weights(joints, weights), r = summed_turns(joints, w);
    vec4 d = w.x * view_from_canonical_d[joints.x];
    if (INFLUENCES > 1) d += w.y * view_from_canonical_d[joints.y];
    if (INFLUENCES > 2) d += w.z * view_from_canonical_d[joints.z];
    if (INFLUENCES > 3) d += w.w * view_from_canonical_d[joints.w];
    float shrink = inversesqrt(dot(r, r));
    r *= shrink;
    d *= shrink;
    vec3 turned = point + 2.0 * cross(r.xyz, cross(r.xyz, point) + r.w * point);
    return turned + 2.0 * (r.w * d.xyz - d.w * r.xyz + cross(r.xyz, d.xyz));
}
