#version 330
// How dark a level plane is, from a texture of it. Black, premultiplied.
uniform sampler2D soft;
uniform float strength;

in vec2 at;  // on the texture, [0,1]

out vec4 color;

void main() {
    color = vec4(0.0, 0.0, 0.0, strength * texture(soft, at).r);
}
