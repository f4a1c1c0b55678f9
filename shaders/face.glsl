// A face that moves: where a vertex is in the canonical frame, before the bones (player/draw/face.py).
//
//     x = position + o.xyz     n = normal + o.w o.xyz     o: the texel of the vertex's slot; slot 0 never moves
//
// o.w: 1 / r of a ball, whose normals turn with it, 0 of skin, whose normals stay. FACE: 0 nothing moves.
#if FACE != 0
uniform sampler2D face_offsets;  // canonical, metres; 64 texels a row

in uint face_slot;

vec4 face_offset() {
    int slot = int(face_slot);
    return texelFetch(face_offsets, ivec2(slot & 63, slot >> 6), 0);
}

vec3 faced(vec3 position) {
    return position + face_offset().xyz;
}

vec3 faced_normal(vec3 normal) {
    vec4 offset = face_offset();
    return normal + offset.w * offset.xyz;
}
#else
vec3 faced(vec3 position) {
    return position;
}

vec3 faced_normal(vec3 normal) {
    return normal;
}
#endif
