// In place of bones.glsl, for many copies.
#include "copies.glsl"

mat4x3 bone(uint joint) {
    return transpose(mat3x4(of_bone(0, joint), of_bone(1, joint), of_bone(2, joint)));
}
