#version 330
// The surroundings as the camera sees them: a panorama (equirectangular, linear light) looked up along each pixel's
// ray. Drawn when the camera turns, at the size of the image; frames copy the result. player/effects/panorama.py.
//
//     d = world_from_camera K^-1 (x, y, 1)
//     u = 1/2 + atan(d_x, -d_z) / 2 pi      v = 1/2 - asin(d_y) / pi      (v down; the middle looks along -z)
//
// The mip is one number for the whole picture: derivatives of u jump where the panorama closes, and would draw
// a seam there.
#include "tone.glsl"

uniform sampler2D panorama;
uniform mat3 direction_from_pixel;
uniform float exposure;  // linear scale
uniform float mip;       // texels of the panorama to a pixel, as a power of two

out vec4 color;

const float PI = 3.14159265358979;

void main() {
    vec3 d = normalize(direction_from_pixel * vec3(gl_FragCoord.xy, 1.0));
    vec2 place = vec2(0.5 + atan(d.x, -d.z) / (2.0 * PI), 0.5 - asin(clamp(d.y, -1.0, 1.0)) / PI);
    vec3 light = exposure * textureLod(panorama, place, mip).rgb;
    color = vec4(srgb_from_linear(tone_mapped(light)), 1.0);
}
