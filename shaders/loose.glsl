// Hair, skirts and sleeves: how far a vertex is moved from where it is skinned to (player/effects/loose_motion.py).
//
//     x_view = skinned(x) + sum_k f_k o_k      o_k: offset of the k-th particle near it, f_k: how far it follows
//
// Mirrored by player/gl/blocks.py, LOOSE. Skin follows by 0.
layout(std140) uniform Loose {
    vec4 loose_offset[300];  // view, metres; w unused
};

vec3 loosened(uvec4 particles, vec4 follows) {
    return follows.x * loose_offset[particles.x].xyz
         + follows.y * loose_offset[particles.y].xyz
         + follows.z * loose_offset[particles.z].xyz
         + follows.w * loose_offset[particles.w].xyz;
}
