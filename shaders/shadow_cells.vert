#version 330
// The cells of a shadow mask that a shadow can reach, one an instance, on a level plane: in software a pixel of shadow
// costs more than the body's, and most of the mask is empty. Mirrored by player/effects/shadow.py.
#include "shadow_smoothed.glsl"

const int CELL = 4;  // mip whose texels are the cells

uniform vec4 clip_from_plane[3];  // as in plane.vert
uniform float across;             // of the mask, metres
uniform int reach;                // cells that an edge is wide, at most
uniform float search;             // mip in which shadow.frag's height is looked for

out vec2 at;     // on the mask, [0,1]
out vec2 about;  // the mask over the breadth that is searched

void main() {
    int cells = textureSize(mask, CELL).x;
    ivec2 cell = ivec2(gl_InstanceID % cells, gl_InstanceID / cells);
    float cover = 0.0;
    for (int y = max(cell.y - reach, 0); y <= min(cell.y + reach, cells - 1); y++) {
        for (int x = max(cell.x - reach, 0); x <= min(cell.x + reach, cells - 1); x++) {
            cover = max(cover, texelFetch(mask, ivec2(x, y), CELL).r);
        }
    }
    at = (vec2(cell) + vec2(gl_VertexID & 1, gl_VertexID >> 1)) / float(cells);
    about = smoothed(at, search);
    vec2 place = at * across;
    vec4 here = clip_from_plane[0] * place.x + clip_from_plane[1] * place.y + clip_from_plane[2];
    // an empty cell has no corners
    gl_Position = cover > 0.0 ? here : vec4(0.0, 0.0, 0.0, 1.0);
}
