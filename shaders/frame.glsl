// Per-frame constants, one copy for every pass. Mirrored by player/gl/blocks.py, FRAME.
// View space is the world seen from the eye: right-handed, +y up, looking down -z, metres. All posing goes
// straight into it (skinning.glsl), in double precision up to the last step, so a body 10 km from the origin
// of the world does not tremble.
layout(std140) uniform Frame {
    mat4 clip_from_view;
    float view_amount;  // u_view: 0 is the paper (colour by surface point alone), 1 the full baked cone
};
