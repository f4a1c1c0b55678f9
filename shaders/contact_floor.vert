#version 330
// The cells of the ground that a body's capsules can darken: corners of a grid, of which player/passes/contact.py lists
// the triangles.

const int CELLS = 24;  // each way; mirrored there

uniform vec4 clip_from_plane[3];  // as in plane.vert
uniform vec2 across;              // of the grid, metres

out vec2 place;  // x, z about the anchor, metres

void main() {
    place = across * vec2(gl_VertexID % (CELLS + 1), gl_VertexID / (CELLS + 1)) / float(CELLS);
    gl_Position = clip_from_plane[0] * place.x + clip_from_plane[1] * place.y + clip_from_plane[2];
}
