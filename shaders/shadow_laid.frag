#version 330
// The softened shadow (shadow.frag) on the ground. Black, premultiplied.
uniform sampler2D soft;
uniform float strength;

in vec2 at;  // on the mask, [0,1]

out vec4 color;

void main() {
    color = vec4(0.0, 0.0, 0.0, strength * texture(soft, at).r);
}
