#version 330
// One triangle over the whole image; no vertex data. The fragment stage finds its pixel in gl_FragCoord.

void main() {
    vec2 corner = vec2(gl_VertexID & 1, gl_VertexID >> 1);
    gl_Position = vec4(4.0 * corner - 1.0, 0.0, 1.0);
}
