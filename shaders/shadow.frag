#version 330
// A shadow on the ground, sharp where what throws it touches, softer the higher that is (Fernando 2005, percentage-
// closer soft shadows, on a mask in the ground's own coordinates): the mask's mean height about a place says how wide
// the lamp's edge is there, and the mask is averaged over that width by its mipmaps. Drawn in the mask's coordinates,
// once for each pose: eight fetches from mipmaps are too many for every pixel of every frame (shadow_laid.frag).
uniform sampler2D mask;  // cover; cover times (1 - height / tall)
uniform float spread;    // texels that the edge is wide, for what is as high as the mask tells
uniform float search;    // mip in which the height is looked for

in vec2 at;  // on the mask, [0,1]

out float shadow;  // 1: the lamp is wholly hidden

// Four fetches half a texel of the mip off: no edge of a texel shows, at any mip between two.
// The finest is left sharper.
vec2 smoothed(float mip) {
    vec2 off = (0.5 * exp2(mip) - 0.25) / vec2(textureSize(mask, 0));
    return 0.25 * (textureLod(mask, at - off, mip).rg + textureLod(mask, at + off, mip).rg
                   + textureLod(mask, at + vec2(off.x, -off.y), mip).rg
                   + textureLod(mask, at + vec2(-off.x, off.y), mip).rg);
}

void main() {
    vec2 about = smoothed(search);
    shadow = 0.0;
    if (about.r > 0.001) {
        float height = 1.0 - about.g / about.r;
        shadow = smoothed(log2(max(height * spread, 1.0))).r;
    }
}
