// Rotations of the bones of the one avatar that is drawn, quaternions xyzw. Mirrored by
// player/gl/blocks.py, TURNS.
#include "bone_count.glsl"

layout(std140) uniform Turns {
    vec4 view_from_canonical_q[BONE_COUNT];
};

vec4 turn_of(uint joint) {
    return view_from_canonical_q[joint];
}
