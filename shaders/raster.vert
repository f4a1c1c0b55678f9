#version 330
// Measuring rasteriser: which triangle covers a pixel, where on it, and how deep. player/draw/raster.py, Rasteriser.
// Vertices come unshared, three per triangle, already in view space (+y up, looking down -z, metres).

uniform mat4 clip_from_view;

in vec3 position_view;

out vec2 barycentric;  // of corners 1 and 2; corner 0 has what is left of 1
out float depth;       // metres along the optical axis

void main() {
    int corner = gl_VertexID % 3;
    barycentric = vec2(corner == 1, corner == 2);
    depth = -position_view.z;
    gl_Position = clip_from_view * vec4(position_view, 1.0);
}
