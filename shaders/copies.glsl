// The bones of many copies of one avatar that are drawn at once: a row of texels a copy, 52 texels a section.
// Sections: 0, 1, 2 the rows of view_from_canonical, or 0 the dual parts; 3 the rotations. Mirrored by
// player/copies.py.
uniform sampler2D palettes;
uniform int first_copy;  // row of the first that is drawn

vec4 of_bone(int section, uint joint) {
    return texelFetch(palettes, ivec2(52 * section + int(joint), first_copy + gl_InstanceID), 0);
}
