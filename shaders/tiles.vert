#version 330
// Rectangles of the image, one an instance, each pixel in one of them at most. player/gl/tiles.py makes them.

uniform vec2 image_size;  // pixels

in uvec4 tile;  // left, first row, right, end row, pixels

void main() {
    vec2 corner = vec2((gl_VertexID & 1) == 0 ? tile.x : tile.z, (gl_VertexID >> 1) == 0 ? tile.y : tile.w);
    gl_Position = vec4(2.0 * corner / image_size - 1.0, 0.0, 1.0);
}
