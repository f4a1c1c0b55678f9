// t q / 2 of the bones of the one avatar that is drawn, xyzw. Mirrored by player/gl/blocks.py, DUALS.
#include "bone_count.glsl"

layout(std140) uniform Duals {
    vec4 view_from_canonical_d[BONE_COUNT];
};

vec4 dual_of(uint joint) {
    return view_from_canonical_d[joint];
}
