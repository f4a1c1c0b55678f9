// Bones of the one avatar that is drawn. Mirrored by player/blocks.py, BONES; of many copies: copies_bones.glsl.
layout(std140, row_major) uniform Bones {
    mat4x3 view_from_canonical[52];
};

mat4x3 bone(uint joint) {
    return view_from_canonical[joint];
}
