// In place of duals.glsl, for many copies.
#include "copies.glsl"

vec4 dual_of(uint joint) {
    return of_bone(0, joint);
}
