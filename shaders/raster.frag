#version 330
// See raster.vert. A float holds every triangle number up to 2^24 exactly; 0 is the background.

in vec2 barycentric;
in float depth;

out vec4 fragment;

void main() {
    fragment = vec4(float(gl_PrimitiveID + 1), barycentric, depth);
}
