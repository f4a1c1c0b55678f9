// In place of turns.glsl, for many copies.
#include "copies.glsl"

vec4 turn_of(uint joint) {
    return of_bone(3, joint);
}
