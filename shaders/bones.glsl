// Bones of the one avatar that is drawn. Mirrored by player/gl/blocks.py, BONES.
#include "bone_count.glsl"

layout(std140, row_major) uniform Bones {
    mat4x3 view_from_canonical[BONE_COUNT];
};

mat4x3 bone(uint joint) {
    return view_from_canonical[joint];
}
