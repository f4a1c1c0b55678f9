#version 330
// A shadow on the ground, sharp where what throws it touches, softer the higher that is (Fernando 2005, percentage-
// closer soft shadows, on a mask in the ground's own coordinates): the mask's mean height about a place says how wide
// the lamp's edge is there, and the mask is averaged over that width by its mipmaps. Drawn in the mask's coordinates,
// once for each pose: fetches from mipmaps are too many for every pixel of every frame (shadow_laid.frag).
#include "shadow_smoothed.glsl"

uniform float spread;  // texels that the edge is wide, for what is as high as the mask tells

in vec2 at;     // on the mask, [0,1]
in vec2 about;  // the mask over the breadth that is searched, as smooth as the cells' corners show it

out float shadow;  // 1: the lamp is wholly hidden

void main() {
    shadow = 0.0;
    if (about.r > 0.001) {
        float height = 1.0 - about.g / about.r;
        shadow = smoothed(at, log2(max(height * spread, 1.0))).r;
    }
}
